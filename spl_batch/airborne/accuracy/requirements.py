"""Is it good enough? Each requirement of a contract, what was found, and whether that will do.

Sources: ASPRS Positional Accuracy Standards for Digital Geospatial Data, Edition 2, Version 1.0
(2023), by section; USGS Lidar Base Specification 2025 rev. A, by the headings of its sections. The
limits of a quality level are in :data:`~spl_batch.airborne.settings.standards.LEVELS`. Nothing
passes for want of evidence: what nobody measured is "cannot tell", with what would tell it.
"""

from collections.abc import Callable, Iterable, Mapping
from typing import Final, Literal

from pydantic import Field
from pydantic.dataclasses import dataclass

from spl_batch.airborne.accuracy.checkpoint_errors import EDITION, STANDARD
from spl_batch.airborne.accuracy.evidence import Evidence
from spl_batch.airborne.pulses.swaths import SwathTotals
from spl_batch.airborne.settings.standards import ASKED, LEVELS
from spl_batch.constants import (
    CLASS_HIGH_NOISE,
    CLASS_LOW_NOISE,
    CLASS_NEVER_CLASSIFIED,
    CLASS_OVERLAP,
)
from spl_batch.engine.report.number_format import number, percent, significant
from spl_batch.engine.report.parts import STRICT
from spl_batch.errors import named

Answer = Literal["pass", "fail", "cannot tell"]

LBS: Final = "USGS Lidar Base Specification 2025 rev. A"

COLLECTION: Final = "Collection Requirements"
PROCESSING: Final = "Data Processing and Handling"

SMALL_SHARE: Final = 0.01
"""A flightline with less than this share of the largest one's area is not judged by itself, fewer
first returns in none of them do not matter, nor does a smaller area off the edge, 0..1."""


@dataclass(frozen=True, config=STRICT)
class Requirement:
    """One requirement of a contract, and whether it is met."""

    name: str = Field(description="What is required of.")
    required: str = Field(description="What is asked for, with units.")
    found: str = Field(description="What was found, with units.")
    verdict: Answer = Field(description="Whether it is met.")
    why: str = Field(description="What that rests on, or what would decide.")
    standard: str = Field(description="Who requires it.")
    section: str = Field(description="Edition and section.")


def requirements(known: Evidence) -> tuple[Requirement, ...]:
    """Every line of the page, accuracy first."""
    rows = (_accuracy, _vegetated, _mean_error, _density, _distribution, _voids, _overlap,
            _class_zero, _noise_classes, _no_class_12,
            _vertical_datum, _gps_time)  # fmt: skip
    return tuple(row(known) for row in rows)


def _accuracy(known: Evidence) -> Requirement:
    limit, nva = known.rmse_v_m, known.nva
    required = (
        f"RMSE_V at most {known.height(limit)} at {ASKED.checkpoints} open checkpoints or more"
    )
    place = ("Absolute vertical accuracy, NVA", required)
    section = (
        f"{EDITION}, sections 7.4, 7.12 and 7.13; {LBS}, {PROCESSING}, Absolute Vertical Accuracy; "
        "Table 4"
    )
    if nva is None or not nva.n:
        why = (
            "no open checkpoint lies on the terrain"
            if nva is not None
            else "no checkpoints were given: name them in reference.checkpoints"
        )
        return Requirement(*place, "not tested", "cannot tell", why, STANDARD, section)
    fit, own, whole = map(known.height, (nva.rmse_v1_m, nva.rmse_v2_m, nva.rmse_v_m))
    if nva.rmse_v_m is None:
        found = f"fit {fit} at {nva.n} checkpoints"
        why = "the checkpoints' own accuracy is not given: column accuracy_m"
        return Requirement(*place, found, "cannot tell", why, STANDARD, section)
    found = f"RMSE_V {whole} at {nva.n} checkpoints"
    if nva.n < ASKED.checkpoints:
        why = (
            f"{nva.n} checkpoints are insufficient for a statement, {ASKED.checkpoints} are needed"
        )
        return Requirement(*place, found, "cannot tell", why, STANDARD, section)
    why = f"fit {fit}, checkpoints {own}"
    if nva.outliers:
        why += f"; look at {named(nva.outliers)}"
    answer: Answer = "pass" if nva.rmse_v_m <= limit else "fail"
    if answer == "pass" and (nva.rmse_v2_m or 0.0) > ASKED.known_share * limit:
        answer = "cannot tell"
        why += f": they shall be known to {known.height(ASKED.known_share * limit)}"
    return Requirement(*place, found, answer, why, STANDARD, section)


def _vegetated(known: Evidence) -> Requirement:
    place = (
        "Absolute vertical accuracy, VVA",
        f"reported, {ASKED.checkpoints} checkpoints or more",
    )
    vva = known.vva
    if vva is None or vva.rmse_v_m is None or vva.n < ASKED.checkpoints:
        found = "not tested" if vva is None or not vva.n else f"{vva.n} checkpoints"
        if vva is not None and vva.rmse_v1_m is not None:
            found = f"fit {known.height(vva.rmse_v1_m)} at {vva.n} checkpoints"
        why = f"a statement needs {ASKED.checkpoints} vegetated checkpoints of known accuracy"
        return Requirement(*place, found, "cannot tell", why, STANDARD, f"{EDITION}, section 7.4")
    found = f"RMSE_V {known.height(vva.rmse_v_m)} at {vva.n} checkpoints"
    why = "the standard sets no limit any more: it is reported"
    return Requirement(*place, found, "pass", why, STANDARD, f"{EDITION}, section 7.4")


def _mean_error(known: Evidence) -> Requirement:
    limit = ASKED.mean_share * known.rmse_v_m
    place = ("Systematic error", f"mean error within {known.height(limit)} of zero")
    nva = known.nva
    if nva is None or nva.mean_m is None or nva.n < ASKED.checkpoints:
        why = f"needs {ASKED.checkpoints} open checkpoints"
        found = "not tested" if nva is None else known.height(nva.mean_m)
        return Requirement(*place, found, "cannot tell", why, STANDARD, f"{EDITION}, section 7.2")
    good = abs(nva.mean_m) <= limit
    why = f"a quarter of the largest RMSE_V{'' if good else ': find the cause before delivery'}"
    answer: Answer = "pass" if good else "fail"
    return Requirement(
        *place, known.height(nva.mean_m), answer, why, STANDARD, f"{EDITION}, section 7.2"
    )


def _density(known: Evidence) -> Requirement:
    limit = f"at least {significant(known.pulses_per_m2)} first returns per m\N{SUPERSCRIPT TWO}"
    place = ("Aggregate nominal pulse density", f"{limit}{_MIDDLE if known.single else ''}")
    where = (LBS, f"{COLLECTION}, Nominal Pulse Spacing; Table 1")
    if known.pulses is None or not known.pulses.area_m2:
        return Requirement(*place, "not counted", "cannot tell", _NOT_COUNTED, *where)
    together = known.pulses.pulses / known.pulses.area_m2
    least = {name: one.middle_pulses / one.middle_m2 for name, one in _judged(known).items()}
    why = "highest signal return of each pulse, water excepted"
    return _by_swath(known, place, (together, least, known.pulses_per_m2), _per_m2, why, where)


_NOT_COUNTED: Final = "the raster cells were made by a version that did not count: run again"

_MIDDLE: Final = " within the edges of each flightline"


def _per_m2(density: float) -> str:
    return f"{significant(density)} per m\N{SUPERSCRIPT TWO}"


def _judged(known: Evidence) -> Mapping[str, SwathTotals]:
    """Swaths that are large enough to be judged; none where many returns lie in no flightline."""
    named = {name: one for name, one in known.by_swath.items() if name}
    lost = sum(one.pulses for name, one in known.by_swath.items() if not name)
    if not named or lost > SMALL_SHARE * sum(one.pulses for one in named.values()):
        return {}
    least = SMALL_SHARE * max(one.middle_m2 for one in named.values())
    return {name: one for name, one in named.items() if one.squares and one.middle_m2 >= least}


def _by_swath(
    known: Evidence,
    place: tuple[str, str],
    numbers: tuple[float, Mapping[str, float], float],
    text: Callable[[float], str],
    why: str,
    where: tuple[str, str],
) -> Requirement:
    """Judge what all flightlines have together, what each has by itself, by their limit."""
    together, by_swath, limit = numbers
    whole = f"{text(together)}, all flightlines together"
    enough = together >= limit
    if not known.single:
        return Requirement(*place, whole, "pass" if enough else "fail", why, *where)
    if not by_swath:
        if not enough:
            return Requirement(*place, whole, "fail", why, *where)
        why = "nothing distinguishes flightlines: one by itself may have less"
        return Requirement(*place, whole, "cannot tell", why, *where)
    name = min(by_swath, key=lambda name: (by_swath[name], name))
    found = f"{text(by_swath[name])} in {name}"
    if len(by_swath) > 1:
        found += f", the least of {len(by_swath)} flightlines; all together {text(together)}"
    answer: Answer = "pass" if by_swath[name] >= limit else "fail"
    if answer == "fail" and enough:
        why += "; a survey that reaches it by multiple coverage has requirements.coverage: multiple"
    return Requirement(*place, found, answer, why, *where)


def _distribution(known: Evidence) -> Requirement:
    edge = known.edge(2 * LEVELS[known.level].spacing_m)
    required = f"{percent(ASKED.filled_share, 0)} of squares of {edge} hold a first return"
    place = ("Spatial distribution", f"{required}{',' + _MIDDLE if known.single else ''}")
    where = (LBS, f"{COLLECTION}, Spatial Distribution and Regularity")
    if known.pulses is None or not known.pulses.squares:
        return Requirement(*place, "not counted", "cannot tell", _NOT_COUNTED, *where)
    together = known.pulses.filled / known.pulses.squares
    judged = _judged(known)
    shares = {name: one.filled / one.squares for name, one in judged.items()}
    squares = sum(one.squares for one in judged.values())
    why = f"{number(squares or known.pulses.squares)} squares, water excepted"
    return _by_swath(known, place, (together, shares, ASKED.filled_share), percent, why, where)


def _voids(known: Evidence) -> Requirement:
    edge = known.edge(ASKED.void_spacings * LEVELS[known.level].spacing_m)
    required = f"no empty square of {edge}, water excepted"
    place, where = ("Data voids", required), (LBS, f"{COLLECTION}, Data Voids")
    if known.pulses is None or not known.pulses.area_m2:
        return Requirement(*place, "not counted", "cannot tell", _NOT_COUNTED, *where)
    pulses = known.pulses
    share = percent(pulses.void_m2 / pulses.area_m2, 2)
    found = f"{number(pulses.void_m2)} m\N{SUPERSCRIPT TWO}, {share} of what was flown"
    if pulses.void_m2:
        wanted = LEVELS[known.level].pulses_per_m2
        if pulses.outside_voids_per_m2 < wanted:
            why = (
                f"outside them too are only {_per_m2(pulses.outside_voids_per_m2)} of the "
                f"{significant(wanted)} of {known.level}: so sparse a survey has empty squares on "
                "land; requirements.quality_level names another level"
            )
            return Requirement(*place, found, "fail", why, *where)
        if not known.water_known:
            why = "it may be water, of which nothing is known: draw it and name it as water"
            return Requirement(*place, found, "cannot tell", why, *where)
        why = (
            "dark surfaces and shadows of buildings are excepted too, and not separated here; "
            "density.tif shows where"
        )
        return Requirement(*place, found, "fail", why, *where)
    if pulses.bare_m2 > SMALL_SHARE * pulses.area_m2:
        why = (
            f"{number(pulses.bare_m2)} m\N{SUPERSCRIPT TWO} were flown without signal, off the "
            "edge or in wide holes: look at density.tif"
        )
        return Requirement(*place, "none within the signal", "cannot tell", why, *where)
    return Requirement(*place, "none", "pass", "first returns of all flightlines", *where)


_RELATIVE: Final = f"{PROCESSING}, Positional Accuracy Validation, Relative Vertical Accuracy"
_OVERLAP: Final = f"{_RELATIVE}, Interswath (Overlap) Consistency; Table 2"


def _not_overlapping(known: Evidence) -> str:
    if known.flightlines < 2:
        return "there are no two flightlines to be compared"
    return "no two flightlines share enough smooth places of up to 10 degrees"


def _overlap(known: Evidence) -> Requirement:
    limit = LEVELS[known.level].overlap_rmsd_m
    place = ("Swath overlap difference", f"RMSDz at most {known.height(limit)}")
    swaths = known.swaths
    if swaths is None:
        why = _not_overlapping(known)
        return Requirement(*place, "not measured", "cannot tell", why, LBS, _OVERLAP)
    answer: Answer = "pass" if swaths.rmsd_m <= limit else "fail"
    found = f"RMSDz {known.height(swaths.rmsd_m)}"
    why = (
        f"{number(swaths.places)} smooth places of {swaths.pairs} "
        f"pair{'s' * (swaths.pairs != 1)} of flightlines"
    )
    return Requirement(*place, found, answer, why, LBS, _OVERLAP)


def _class_zero(known: Evidence) -> Requirement:
    withheld = known.withheld_unclassified
    left = known.classes.get(CLASS_NEVER_CLASSIFIED, 0) - withheld
    why = (
        "without a time, or outside the area: they keep the class of the input"
        if left
        else "every point that is not withheld has a class"
    )
    if withheld:
        why += f"; {number(withheld)} withheld ones in class 0 do not count"
    return Requirement(
        "Points never classified", "none in class 0, but withheld ones",
        number(left) if left else "none", "fail" if left else "pass", why, LBS,
        f"{PROCESSING}, Point Classification",
    )  # fmt: skip


def _noise_classes(known: Evidence) -> Requirement:
    low, high = (known.classes.get(kind, 0) for kind in (CLASS_LOW_NOISE, CLASS_HIGH_NOISE))
    found = f"{number(low)} low, {number(high)} high"
    answer: Answer = "pass" if known.filtered else "cannot tell"
    why = "below and above the terrain" if known.filtered else "no noise filter ran"
    return Requirement(
        "Noise", "low in class 7, high in class 18", found, answer, why, LBS,
        f"{PROCESSING}, Point Classification",
    )  # fmt: skip


def _no_class_12(known: Evidence) -> Requirement:
    held = known.classes.get(CLASS_OVERLAP, 0)
    why = "no point is in it" if not held else "the input has them: they are carried along"
    return Requirement(
        "Overlap by flag", "no point in class 12", number(held) if held else "none",
        "fail" if held else "pass", why, LBS, f"{PROCESSING}, Point Classification",
    )  # fmt: skip


def _vertical_datum(known: Evidence) -> Requirement:
    named_datum = known.vertical_datum is not None
    why = (
        "the CRS of clouds, rasters and catalogues is a compound one"
        if named_datum
        else "the CRS of the input has no vertical part: name it in survey.vertical_crs"
        if known.has_crs
        else "no CRS is known: name it in survey.crs, with a vertical part"
    )
    return Requirement(
        "Vertical datum", "named by the CRS", known.vertical_datum or "none",
        "pass" if named_datum else "fail", why, LBS, f"{PROCESSING}, Coordinate Reference System",
    )  # fmt: skip


def _gps_time(known: Evidence) -> Requirement:
    place = ("GPS time", "adjusted standard time")
    where = (LBS, f"{PROCESSING}, Time of Global Positioning System Data")
    if known.time_standard is None:
        return Requirement(*place, "none", "cannot tell", "no point has a time", *where)
    good = known.time_standard == "adjusted"
    why = "by the size of its numbers" + ("" if good else "; the delivery keeps the input's")
    answer: Answer = "pass" if good else "fail"
    return Requirement(*place, f"{known.time_standard} time", answer, why, *where)


def answers(verdicts: Iterable[Answer]) -> dict[Answer, int]:
    """How many requirements are met, are not, and cannot be judged."""
    found: dict[Answer, int] = {"pass": 0, "fail": 0, "cannot tell": 0}
    for verdict in verdicts:
        found[verdict] += 1
    return found
