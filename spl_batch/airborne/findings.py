"""What each code of an airborne survey's findings means (:mod:`spl_batch.engine.findings`)."""

from collections.abc import Mapping
from types import MappingProxyType
from typing import Final

from spl_batch.engine.findings import Code

WARNED_SHARE: Final = 0.02
"""Share of the signal, the terrain or the afterpulses from which on a finding names it, 0..1."""

CODES: Final[Mapping[str, Code]] = MappingProxyType(
    {
        "I01": Code(
            "An input file is odd",
            {
                "header": "{what}",
                "times": "the header states {stated}, gps_time holds {found}",
                "clock": "gps_time is {found}, that of most points of the survey {main}: "
                "flightlines are not put together, and copies count twice",
                "withheld": "every point is withheld or of class 7 or 18, so none of them is used",
                "left_out": "{what}; left out of the delivered copy",
                "changed": "{what}; so in the delivered copy",
            },
            noun="file",
        ),
        "I02": Code(
            "Points without a usable time",
            {
                "file": "no usable gps_time (none, not finite, scattered, or the same for every "
                "point)",
                "points": "{count:points|have} no usable gps_time ({what})",
                "format": "point format {format} has no gps_time",
            },
            "where points are filtered, these are delivered with noise_class 255, not assessed, "
            "and used for nothing else; unfiltered, they are as good as others",
            "give the files their times; filter.method: none and afterpulse.enabled: false make "
            "ground and surfaces without",
            "file",
        ),
        "I03": Code(
            "Returns are there twice",
            {
                "repeated": "{count} of {points} points repeat an earlier one, with the same time, "
                "channel, return number and place",
                "files": "{count:returns|are} in both files, at the same time and place",
                "saved": "both files have {points} points in the same box, by another scale: where "
                "one is a copy of the other, each return counts twice",
                "flightlines": "flightlines with other point source ids begin and end at the same "
                "times ({first_s:.6f} to {last_s:.6f} s), and each has {points} returns: each "
                "counts as a look of its own, and density is too high",
                "elsewhere": "returns of the same time and channel lie more than {km:.0f} km "
                "apart, as where a file is a copy in another place: each counts as a look of its "
                "own",
            },
            "copies of single returns count once and are delivered as not assessed",
            "leave the copies out",
        ),
        "I04": Code(
            "Numbers of the beamlets",
            {
                "unnamed": "survey.channel_dimension is not set, but {dimension} holds {ranges}, "
                "as the {beamlets} beamlets of {sensor} are numbered: write `channel_dimension: "
                "{dimension}` under survey",
                "more": "returns come from {alive} channels, but the sensor has {beamlets}; "
                "{alive} are assumed; least often seen: {channels}",
            },
            "without numbers a shot counts as one beamlet",
            "name the dimension that holds the numbers, or leave survey.channel_dimension out",
        ),
        "I07": Code(
            "Channels without returns",
            {
                "gaps": "{dead} of {beamlets} channels have no returns; gaps in the numbers of the "
                "others, from {first} to {last}: {gaps}",
                "whole": "{dead} of {beamlets} channels have no returns; the numbers of the "
                "others, from {first} to {last}, have no gaps",
            },
            "they are taken into account",
            "report to who maintains the instrument if it had more before",
            "flightline",
            "note",
        ),
        "I05": Code(
            "Place and CRS",
            {
                "degrees": "the coordinates look like degrees, but the CRS is in metres, so they "
                "are taken as metres",
                "wide": "its {points} points span {km:.0f} km; some of them must lie astray, and "
                "of rasters too large for a file the part with most points is made",
                "far": "{km:.0f} km from the rest of the survey ({main}), farther than its files "
                "are long ({length_m:.0f} m); of rasters too large for a file the part with most "
                "points is made",
                "astray": "{count:points|lie} up to {km:.1f} km outside the rest, alone in their "
                "tiles; rasters that reach there are {times:.0f} times as large",
                "shapes": "{key}: none of its polygons meets the survey: they lie within {shapes}, "
                "its points within {points}",
                "scale": "{crs} draws lengths {lengths:.3f} and areas {areas:.3f} times as large "
                "as they are: distances, densities and volumes are off by that",
                "geoid": "{count:cells|lie} beyond the grid {grid}: void; name one that reaches "
                "there",
                "grid": "{key}: {what}",
            },
            remedy="check the CRS, the order of its axes and the coordinates, and fetch a grid "
            "that is lacking",
            noun="file",
        ),
        "I08": Code(
            "No CRS",
            {
                "none": "no input file carries a CRS and survey.crs is not set: coordinates and "
                "heights are taken as metres; where they are feet, name a CRS in feet with heights "
                "in feet, survey.crs: EPSG:...+6360",
                "local": "the CRS that files name, {crs}, does not show where on earth it is",
                "others": "no CRS in the file; its coordinates are taken as {crs}, in {unit}, as "
                "of others",
                "vertical": "no vertical datum in the file; its heights are taken as {crs}, as of "
                "others",
                "unit": "nothing states the unit of heights; they are taken in {unit}, as "
                "eastings are (survey.vertical_crs: {codes})",
            },
            "rasters and clouds name none, or that one, or that of others",
            "write `crs: EPSG:...` or `vertical_crs: EPSG:...` under survey",
            "file",
        ),
        "I06": Code("A setting is without effect", "{what}"),
        "T01": Code(
            "Pulse rate and shots",
            {
                "assumed": "gps_time does not show the pulse rate, so {prf_hz:.0f} Hz is assumed",
                "contradicted": "gps_time shows a pulse rate of about {prf_hz:.0f} Hz, not the "
                "{stated_hz:.0f} Hz stated, and noise is computed with the stated one",
                "merged": "{share:.0%} of the returns with the same time and channel do not lie on "
                "one beam: gps_time is rounded to more than the time between shots, or "
                "survey.channel_dimension holds no beamlet numbers",
            },
            "afterpulses and noise are counted along wrong shots: ground, roofs and leaves may be "
            "lost",
            "state acquisition.prf_hz as it was flown, and deliver times that separate shots",
            "flightline",
        ),
        "T02": Code(
            "The trajectory does not fit the points",
            {
                "leap": "the trajectory's times are {leap_s} s {late}: shifted by that the sensor "
                "is above its returns",
                "late": "the returns lie {side} the sensor on average, so the trajectory's times "
                "seem about {seconds:.1f} s {late}; a part of each scan alone looks so, too",
                "uncovered": "the trajectory does not cover {count:returns} between gps_time "
                "{first_s:.3f} and {last_s:.3f}, or they do not lie below it",
                "unit": "puts the sensor {stated_m:length} above its returns in {line}, whose "
                "lines of sight meet {met_m:length} above them: its heights seem to be in {unit}; "
                "name its CRS with that of its heights, survey.trajectory_crs: {crs}",
                "file": "{what}",
            },
            "noise and reflectance are computed along wrong beams, or returns stay unfiltered",
            "correct the trajectory's times or heights, name its CRS in survey.trajectory_crs, or "
            "name the trajectory of this flight",
        ),
        "T03": Code(
            "No trajectory",
            "beams taken {how}",
            "noise near the ends of the gate is known less well",
            "name it in survey.trajectory if there is one",
        ),
        "N01": Code(
            "Noise or gate of a flightline are poorly known",
            {
                "none": "no return has a known beam, so there is no noise model",
                "few": "an interval holds only {per_interval:.1f} beamlets with a return, so the "
                "noise rate is too low by about {low:.0%}: raise noise.interval_shots",
                "strays": "{count:returns|lie} far beyond the range gate, which noise does not "
                "reach, as where ranges are wrong; they do not count",
                "short": "the range gate is short: noise is counted from {share:.0%} of "
                "noise.buffer_m away from the surface on",
                "full": "the range gate leaves hardly a part without signal to count noise in: "
                "lower noise.buffer_m if it is wide",
                "side": "{times:.1f} times as many returns {more} the surface as on its other "
                "side; noise is counted {side} it only",
                "assumed": "too few returns lie away from the surface to show the range gate, so "
                "{gate_m:.0f} m is assumed",
                "gate": "the returns fill a gate of {gate_m:.0f} m, not the {stated_m:.0f} m "
                "stated; {gate_m:.0f} m is used",
            },
            "more noise may stay, or weak signals may be lost",
            "state acquisition.gate_m as it was flown; look at the map of noise",
            "flightline",
            implied_by={
                "": ("I04:unnamed", "T02:leap", "T02:late"),
                "side": ("N02", "N03"),
            },
        ),
        "N02": Code(
            "Noise is not what its model expects",
            "away from all surfaces there is {ratio:.2f} times the noise that its model expects "
            "between {low_m:length} and {high_m:length} in height",
            "where there is more, the filter keeps more than filter.alpha; where there is less, "
            "weak signals are lost",
            "look at the profile there; if this is linear-mode lidar, which has no such noise, set "
            "filter.method: none",
            "block",
        ),
        "N03": Code(
            "Haze or cloud was taken for noise",
            "between {low_m:length} and {high_m:length} in height {area_m2:.0f} m2 of air send "
            "back {ratio:.1f} times what the model of the noise expects",
            "its returns are class 18 (7 below ground), and weak signals among them are lost",
            "look at the profile there",
        ),
        "N04": Code(
            "Signal fills the air",
            "signals fill the air evenly over {area_m2:.0f} m2, {low_m:length} to {high_m:length} "
            "above the ground",
            "fog, haze, a cloud or noise in clusters, if no plants without gaps: it stays signal, "
            "and the DSM may lie on it",
            "look at the profile there, and classify by hand what is no surface",
            "ground cell",
            implied_by={"": ("S01",)},
        ),
        "N07": Code(
            "Signal floats",
            {
                "thick": "{share:.1%} of the signal has nothing in the 15 m below it, though "
                "something lies farther down, over {area_m2:.0f} m2",
                "alone": "{count:cells|rise} more than {least_m:length} above all but one cell of "
                "the DSM beside them, up to {highest_m:length} above the terrain",
            },
            "haze, a cloud, stray light or noise in clusters, if no many wires or cranes are "
            "there: it stays signal, and the DSM may lie on it",
            "look at the profile there, and classify by hand what is no surface",
            "ground cell",
            implied_by={"": ("S01", "N03", "N04")},
        ),
        "N05": Code(
            "P-values of noise are not uniform",
            "below all surfaces, where noise lies alone, {times:.2f} times as many of {returns} "
            "returns as expected have a p-value up to {p_value:g}",
            "above 1 the noise comes in clusters or is denser than expected, and more of it stays; "
            "below 1 it is thinner, and weak signals are lost",
            "look at the map of noise; see the findings on its model",
            "ground cell",
            implied_by={"": ("N02", "N03", "N04")},
        ),
        "N06": Code(
            "Most points are unfiltered",
            "{share:.0%} of the points have no usable time or no trajectory there",
            "they stay unfiltered, noise among them",
            "mend the times or the trajectory and run again",
        ),
        "A01": Code(
            "Afterpulses do not follow their law",
            {
                "late": "{share:.0%} of the afterpulses lie more than {stated_m:g} m behind the "
                "return that started them, up to {longest_m:.0f} m, and the sensor states "
                "{stated_m:g} m",
                "uneven": "in {count} of {of} stretches returns of hard surfaces are followed more "
                "or less often than the law of the flightline expects, {times:.1f} times as often "
                "between gps_time {first_s:.0f} and {last_s:.0f}",
                "spread": "returns of hard surfaces spread by {sigma_m:.3f} m along the beam, and "
                "the sensor states {stated_m:.3f} m: surfaces are taken as thick as that",
            },
            "among leaves more afterpulses stay, or true returns are lost as such; heights of "
            "single returns are less certain",
            "correct afterpulse_lag_max_m or range_sigma_m of the sensor if they are known better",
            "flightline",
        ),
        "S01": Code(
            "Flightlines differ in height or place",
            "{pairs} of {of} pairs of flightlines differ by more than single ranges scatter: at "
            "worst {second} lies {offset_m:height} than {first} ({patches} planar patches)",
            "surfaces that both have seen appear twice, and the terrain follows the lower one",
            "{remedy}",
        ),
        "S02": Code(
            "Flightlines are not compared",
            {
                "alone": "{count:flightlines|share} too few planar patches with others and stay: "
                "{names}",
                "far": "would have to be shifted by {up_m:length} up, more than the "
                "{most_m:length} that are allowed: it stays",
            },
            remedy="look at the trajectory and its datum; survey.gap_s may be shorter than pauses "
            "within a flightline",
            noun="flightline",
        ),
        "G01": Code(
            "Terrain is known poorly",
            "{share:.1%} of the terrain model has a standard deviation of more than "
            "{sigma_m:length}; the largest place has {area_m2:.0f} m2",
            "ground returns are far there for ground so rough, or what stood there was cut off",
            "measure no heights or volumes where dtm_quality.tif shows it; classify bridges, dams "
            "and crests by hand if they matter",
        ),
        "G02": Code(
            "Voids in the terrain",
            "{count:voids} of the terrain, {area_m2:.0f} m2, the largest {largest_m2:.0f} m2: no "
            "ground near enough, by products.void_max_m ({void_max_m:g} m) and "
            "products.edge_max_m, or water without a level",
            "there are no heights",
            "breaklines give water its level; larger products.void_max_m and edge_max_m fill roofs "
            "and woods",
        ),
        "G03": Code(
            "Classes of vegetation",
            "{per_m2:.2g} returns per m2 are too few for classes 3 and 4 of classes.vegetation",
            "the ground takes shrubs and hedges lower than {high_m:length}",
            "rest nothing on these two classes",
        ),
        "G04": Code(
            "Breaklines do not fit",
            {
                "none": "no lake and no river covers a cell of the survey",
                "flooded": "water stands more than {above_m:length} above {count} of {of} cells of "
                "terrain beside it",
            },
            "such water is not in the rasters, or floods them",
            "check CRS, heights, vertical datum and banks of the breaklines",
        ),
        "C01": Code(
            "Checkpoints",
            {
                "file": "{what}",
                "beyond": "{count:checkpoints|lie} where the terrain model has no value, and count "
                "for nothing: {names}",
                "blunder": "{count} of {of} checkpoints differ from the terrain by more than "
                "{limit_m:height} and far from the others: {names}; at worst {worst}, DTM minus "
                "checkpoint {error_m:height}; they count in every RMSE, so correct them, or look "
                "at the terrain there",
                "feet": "the heights of {count} checkpoints are {ratio:.3f} times those of the "
                "terrain, as where one is in feet and the other in metres: name the CRS of their "
                "heights, reference.checkpoints_crs: EPSG:...+5703 ({codes})",
            },
            noun="file",
        ),
        "C02": Code(
            "The reference does not serve",
            {
                "missing": "the store holds no comparison with the reference; `spl-batch run` "
                "computes it",
                "own": "reference.points holds the survey's own points: {share:.0%} of those "
                "looked at lie in the survey at the same x, y and z",
            },
            "there is no figure of accuracy",
            "name points of another survey and run again",
        ),
        "D01": Code("A catalogue is not complete", "{what}"),
    }
)
"""Codes by room: inputs, times, noise, afterpulses, swaths, ground, checks, delivery."""
