"""What the shots of a flightline show of its noise and its afterpulses, stretch by stretch.

Domain: time. A stretch is a run of whole shots; what is observed of several is fitted together, and
each is assessed by what was fitted. A survey's tasks and the functions on arrays call the same.
"""

from collections.abc import Sequence
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from spl_batch.airborne.afterpulse import afterpulse_law, candidates
from spl_batch.airborne.afterpulse.afterpulse_law import AfterpulseLaw
from spl_batch.airborne.beams.separate_beamlets import separate_beamlets
from spl_batch.airborne.noise import gains, line_noise, line_statistics
from spl_batch.airborne.noise.line_model import LineModel
from spl_batch.airborne.sensors.sensor import Sensor
from spl_batch.airborne.settings import NoiseSettings
from spl_batch.airborne.settings.workflow import Workflow
from spl_batch.constants import QUANTUM_M
from spl_batch.lattice.tables import BeamTable, PointFlag, PointTable

COLUMNS_ADDED: Final = (
    "line_density", "afterpulse", "afterpulse_rate", "afterpulse_share", "range_sigma",
)  # fmt: skip
"""Columns that :func:`assess` adds, float32; 0 where no beam is known."""


class Assessed(NamedTuple):
    """Points of a stretch with what the time domain knows of them."""

    table: PointTable  #: All, with the columns that are added and ``NO_BEAM, SHOT_NOISE`` flagged.
    lit: PointTable  #: As they were given, those whose beams are known.
    beams: BeamTable  #: Lines of sight of these.
    ground: NDArray[np.float64]  #: Gain of what the beamlet of each of these looks at.


class Beamlets(NamedTuple):
    """How the shots of a flightline are seen."""

    stated: Sensor  #: The instrument.
    numbered: int  #: Beamlets that the files number; 1 without a channel dimension.
    unnumbered: bool  #: Whether beams separate beamlets that nobody has numbered.

    @property
    def seen(self) -> Sensor:
        """The instrument as the files show it."""
        return self.stated.model_copy(update={"beamlets": self.numbered})


def observe(
    table: PointTable, beams: BeamTable, settings: NoiseSettings, beamlets: Beamlets
) -> dict[str, NDArray[Any]]:
    """Noise statistics of a stretch, at least one point, and those of its afterpulses."""
    observed = line_statistics.observe(table, beams, settings, beamlets.stated.gate_m)
    if beamlets.unnumbered:
        table, order = separate_beamlets(table, beams, beamlets.stated)
        beams = beams.take(order)
    return observed | candidates.observe(table, beams, beamlets.stated)


def fit(
    parts: Sequence[dict[str, NDArray[Any]]], settings: NoiseSettings, beamlets: Beamlets
) -> tuple[LineModel, AfterpulseLaw, float]:
    """Line noise model and law of afterpulses, from what stretches observed.

    And the noise that the law was fitted to: without channels the model's is that of a whole shot.
    """
    sensor = beamlets.seen
    model = line_noise.fit(line_statistics.merge(list(parts)), settings, sensor)
    of_one = beamlets.stated.beamlets if beamlets.unnumbered else 1
    rate = model.mean_rate / of_one
    return model, afterpulse_law.fit(list(parts), rate, sensor), rate


def assess(
    table: PointTable,
    beams: BeamTable,
    fitted: tuple[LineModel, AfterpulseLaw],
    settings: Workflow,
    beamlets: Beamlets,
) -> Assessed:
    """Add what the time domain knows of each point of a stretch.

    Returns far beyond a stated gate are noise, and flagged ``SHOT_NOISE``.

    Parameters
    ----------
    table, beams
        Points of a stretch, in time order, and their lines of sight.
    fitted : (LineModel, AfterpulseLaw)
        From :func:`fit`.
    """
    model, law = fitted
    rows = np.flatnonzero(beams.known)
    known, lit = (table, beams) if len(rows) == len(table) else (table.take(rows), beams.take(rows))
    added: dict[str, NDArray[Any]] = {
        name: np.zeros(len(table), np.float32) for name in COLUMNS_ADDED
    }
    ground = gains.looked_at(known, lit, model)
    added["line_density"][rows] = line_noise.line_density(known, model) * ground
    flags = np.where(beams.known, table["flags"], table["flags"] | PointFlag.NO_BEAM)
    beyond = model.beyond_gate(known["shot"], lit.range_m, known["z"] * QUANTUM_M)
    flags[rows] |= beyond * np.uint8(PointFlag.SHOT_NOISE)
    added |= {"flags": flags, "channel": table["channel"]}
    assessed = Assessed(table.with_columns(**added), known, lit, ground)
    if not settings.afterpulse.enabled:
        return assessed
    sensor, of_shot = beamlets.seen, 1.0
    if beamlets.unnumbered:
        # A beamlet is one of many of the shot's, whose noise is counted as that of one.
        sensor, of_shot = beamlets.stated, float(beamlets.stated.beamlets)
        known, order = separate_beamlets(known, lit, sensor)
        lit, rows = lit.take(order), rows[order]
        added["channel"] = table["channel"].copy()
        added["channel"][rows] = known["channel"]
    added["afterpulse"][rows], rate = candidates.assess(
        known, lit, settings.afterpulse, sensor, gate_m=model.gate_m, law=law
    )
    added["afterpulse_rate"][rows] = rate * np.float32(of_shot)
    added["afterpulse_share"][rows], added["range_sigma"][rows] = law.probability, law.sigma_m
    return assessed._replace(table=table.with_columns(**added))
