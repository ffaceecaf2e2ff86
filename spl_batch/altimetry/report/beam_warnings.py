"""What a reader has to know of each beam's labels and heights, in sentences."""

from collections.abc import Iterator, Mapping
from typing import Any, Final

from spl_batch.altimetry.filter.chance import LEAST_PHOTONS, SHARE_QUANTA
from spl_batch.altimetry.ground.lost_floor import LostFloor
from spl_batch.altimetry.water.level_water import UNDER_SHARE
from spl_batch.altimetry.water.odd_layers import Layer
from spl_batch.engine.findings import Finding
from spl_batch.engine.report.run_record import Receipts
from spl_batch.errors import grouped

UNSEEN_SHARE: Final = 0.1
"""Share of a track without any noise seen that a reader has to know of."""

_FAR_TIMES: Final = 2.0
"""Far photons among the signal, over those allowed, that are no chance."""

_MIST_SHARE: Final = 0.03
_OVER_SHARE: Final = 0.02
_ECHO_SHARE: Final = 0.1
_LOST_SHARE: Final = 0.2
_DOUBT_SHARE: Final = 0.02
"""Photons of what may be fog over all of the signal, those over and under a surface over those of
the surface, those of an echo over those called floor, and profile cells without their floor over
all of these, and those with a ground in doubt over those with one, that are worth a warning."""

_FEW_TIMES: Final = 4.0
"""Photons of a floor, over the noise expected among them, that are few rather than noise."""

_DARK_M: Final = 500.0
"""Level track with no light from below that is worth a warning [m]."""


def beam_findings(done: Receipts, limit: float) -> list[Finding]:
    """What a reader has to know of each beam's labels, in sentences; alike ones once."""
    found: list[Finding] = []
    for key, delivered in done["deliver_beam"].items():
        source, _, name = key.partition("/")
        beam = f"{done['index_file'][source].facts['name']}: {name}"
        rate, chosen = done["rate"][key].facts, done["select"][key].facts
        kept, noise = (delivered.facts["labels"].get(k, 0) for k in ("1", "0"))
        floor = delivered.facts["floor"]
        if rate["basis"] != "product" and rate["unseen"] > UNSEEN_SHARE:
            text = f"no noise is seen along {rate['unseen']:.0%} of the track; its rate there "
            found.append(_of_beam(beam, f"{text}is an upper bound"))
        found += [_of_beam(beam, text) for text in _cloud(rate["fog"])]
        found += [
            _of_beam(beam, text) for text in _mist(rate["mist"], delivered.facts["mist"], kept)
        ]
        found += [_of_beam(beam, text) for text in _maybe_river(rate["maybe_river"])]
        found += [_of_beam(beam, text) for text in _dark_water(rate["dark_water"])]
        found += [_of_beam(beam, text) for text in _second_surface(chosen, kept, limit)]
        found += [_of_beam(beam, text) for text in _like_noise(chosen, kept, floor)]
        found += [_of_beam(beam, text) for text in _odd_layers(delivered.facts)]
        found += [_of_beam(beam, text) for text in _doubt(done["profile"][key].facts)]
        lost = LostFloor(*done["profile"][key].facts["lost_floor"])
        # A floor that is noise itself is lost nowhere.
        if not chosen["doubtful_floor"][0]:
            found += [_of_beam(beam, text) for text in floor_said(lost)]
        if kept and not noise:
            text = f"all {grouped(kept)} photons are signal; nothing is told apart"
            found.append(_of_beam(beam, text))
        if noise and not kept:
            found.append(_of_beam(beam, _nothing_kept(chosen["estimated"], noise)))
        compared = done.get("compare", {})
        said = compared[key].facts["said"] if key in compared else ()
        found += [_of_beam(beam, text) for text in said]
    return found


def _of_beam(beam: str, text: str) -> Finding:
    return Finding("P02", {"what": text}, beam)


def _nothing_kept(estimated: float, photons: int) -> str:
    """A track without signal, beside what chance does to the number that the rate leaves over."""
    return (
        "no photon is signal: nothing but noise is seen. The noise rate leaves "
        f"{grouped(max(estimated, 0.0))} of {grouped(photons)} photons, and chance alone some "
        f"{grouped(photons**0.5)}; where you know of a surface, a larger rate.buffer_m or "
        "signal.false_share may find it"
    )


def _second_surface(chosen: Mapping[str, Any], kept: int, limit: float) -> Iterator[str]:
    """More signal far from the surface than ``signal.false_share`` lets noise leave there."""
    far = chosen["far_signal"]
    # What noise alone could have given is told of by itself.
    sure = kept - chosen["doubtful"]["photons"]
    if far > _FAR_TIMES * limit * max(kept, 1) and far >= LEAST_PHOTONS and 2.0 * sure > kept:
        yield (
            f"{grouped(far)} of the {grouped(kept)} signal photons lie farther than "
            "rate.buffer_m from the surface, more than signal.false_share allows of noise; a "
            "cloud, a cliff or a second surface is among the signal"
        )


def _stretch(at: Mapping[str, float]) -> str:
    """How much of the track some cells are, and where."""
    pieces = f" in {at['pieces']:.0f} pieces" if at["pieces"] > 1 else ""
    return (
        f"{at['length_m'] / 1000:g} km of track{pieces} between {at['from_m'] / 1000:g} and "
        f"{at['to_m'] / 1000:g} km"
    )


def _cloud(fog: Mapping[str, float]) -> Iterator[str]:
    """A cloud in the gate, and what that means for its photons and those below it."""
    if fog and fog["photons"] >= LEAST_PHOTONS:
        yield (
            f"a layer that floats as a cloud does fills {_stretch(fog)}, most of it at heights of "
            f"{fog['low_m']:.0f} to {fog['high_m']:.0f} m: its "
            f"{grouped(fog['photons'])} photons count as noise of that height, and less light "
            "reaches what is below; thin parts of a cloud may stay signal, and dense woods on a "
            "steep slope may look like one"
        )


def _maybe_river(at: Mapping[str, float]) -> Iterator[str]:
    """Level cells between banks with nothing below."""
    if at:
        yield (
            f"{_stretch(at)} are level between higher banks, with nothing seen below: a river, a "
            "pond, or land as level; called land, its ground is the surface"
        )


def _dark_water(at: Mapping[str, float]) -> Iterator[str]:
    """Water by its level alone."""
    if at and at["length_m"] >= _DARK_M:
        yield (
            f"{_stretch(at)} are as level as water, and no light from below stands out: water or a "
            "flat plain; called water, so its ground has no canopy"
        )


def _mist(mist: Mapping[str, float], signal: int, kept: int) -> Iterator[str]:
    """What may be fog or a low cloud, and what that means for ground and canopy."""
    if mist and signal >= max(LEAST_PHOTONS, _MIST_SHARE * kept):
        yield (
            f"{grouped(signal)} of the {grouped(kept)} signal photons lie in a layer as even as "
            f"fog or a low cloud is, on {mist['length_m'] / 1000:g} km of track between "
            f"{mist['from_m'] / 1000:g} and {mist['to_m'] / 1000:g} km, most of it at heights of "
            f"{mist['low_m']:.0f} to {mist['high_m']:.0f} m: they stay signal, since dense woods "
            "may look like that; where no woods stand, ground and canopy are not to be relied on"
        )


def _like_noise(chosen: Mapping[str, Any], kept: int, floor: int) -> Iterator[str]:
    """What noise alone could have given, of a beam's signal and of its floor."""
    at = chosen["doubtful"]
    if kept and at["photons"] == kept:
        yield (
            f"nothing but noise is seen: the {grouped(kept)} photons called signal cannot be told "
            f"from noise, which comes in clumps ({grouped(at['noise'])} noise photons are expected "
            "among them)"
        )
    elif at["photons"] >= LEAST_PHOTONS:
        yield (
            f"{grouped(at['photons'])} of the {grouped(kept)} signal photons, on "
            f"{at['length_m'] / 1000:g} km of track between {at['from_m'] / 1000:g} and "
            f"{at['to_m'] / 1000:g} km, cannot be told from noise, which comes in clumps "
            f"({grouped(at['noise'])} noise photons are expected among them): signal, ground and "
            "canopy are not to be relied on there"
        )
    photons, noise = chosen["doubtful_floor"]
    if min(photons, floor) >= LEAST_PHOTONS:
        expected = noise / SHARE_QUANTA
        among = f"{grouped(expected)} noise photons are expected among the {grouped(photons)} taken"
        if photons >= _FEW_TIMES * expected:
            yield (
                f"the {grouped(floor)} photons called floor are few: {among} below the surface, "
                "but clumps of noise may be as large; look at the floor before you rely on it"
            )
        else:
            yield (
                f"the {grouped(floor)} photons called floor cannot be told from noise ({among} "
                "below the surface): the floor is not to be relied on"
            )


def _doubt(profile: Mapping[str, Any]) -> Iterator[str]:
    """Ground that may lie in the crowns of closed woods."""
    at, cells = profile["doubt"], profile["ground_cells"]
    if at["cells"] >= max(LEAST_PHOTONS, _DOUBT_SHARE * cells):
        yield (
            f"{grouped(at['cells'])} of {grouped(cells)} ground heights, between "
            f"{at['from_m'] / 1000:g} and {at['to_m'] / 1000:g} km, have photons well below them, "
            "as where closed woods let little light through: ground may lie in the crowns there, "
            f"too high by some {at['depth_m']:.0f} m, canopies too low by as much, and "
            "`ground_error` says so"
        )


def floor_said(floor: LostFloor) -> Iterator[str]:
    """Water whose floor is seen close by and not there."""
    every = floor.lost + floor.found
    if floor.lost >= max(LEAST_PHOTONS, _LOST_SHARE * every):
        yield (
            f"between {floor.from_m / 1000:g} and {floor.to_m / 1000:g} km the floor is lost in "
            f"{grouped(floor.lost)} of {grouped(every)} profile cells of water that show it or lie "
            "close between others that do: it is too steep, rough, faint or deep there, "
            "and an empty floor alone is no sign of it; look at the photons called 40 and 45"
        )


def _odd_layers(delivered: Mapping[str, Any]) -> Iterator[str]:
    """Layers over and under a water surface that may be neither land nor floor."""
    surface = delivered["surface"]
    layers = {name: Layer(*values) for name, values in delivered["layers"].items()}
    where = {
        name: f"{grouped(one.photons)} signal photons between {one.from_m / 1000:g} and "
        f"{one.to_m / 1000:g} km"
        for name, one in layers.items()
    }
    if layers["over"].photons >= max(LEAST_PHOTONS, _OVER_SHARE * surface):
        yield (
            f"{where['over']} lie more than 1 m above a water surface: a cloud, land or a second "
            "surface is among the signal, and heights of ground and canopy are not to be relied "
            "on there"
        )
    under = layers["under"]
    if under.photons >= max(LEAST_PHOTONS, UNDER_SHARE * surface):
        yield (
            f"between {under.from_m / 1000:g} and {under.to_m / 1000:g} km, "
            f"{grouped(under.photons)} signal photons more lie {under.depth_m:g} to 1 m below the "
            "water surface than as far above it: an echo of the detector or a shallow floor is "
            "called surface there, and the surface may lie too low"
        )
    echo = layers["echo"]
    if echo.photons >= max(LEAST_PHOTONS, _ECHO_SHARE * delivered["floor"]):
        yield (
            f"{where['echo']} lie {echo.depth_m:g} m below the water surface nearly all along it: "
            "an echo of the detector, or a flat floor; floor at that depth is not to be relied on"
        )
