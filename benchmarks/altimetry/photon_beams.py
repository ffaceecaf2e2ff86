"""Photons of a beam in memory, labelled and measured without a run."""

from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from spl_batch.altimetry.filter.track import label, window_quanta
from spl_batch.altimetry.ground import over_water
from spl_batch.altimetry.ground.profile import layers_of
from spl_batch.altimetry.settings import TrackWorkflow
from spl_batch.altimetry.simulate import Track, TrackScene
from spl_batch.constants import QUANTA_PER_M

Photons = tuple[NDArray[np.int64], NDArray[np.int32]]
Mask = NDArray[np.bool_]
Kind = Literal["mountain", "flat"]
Colour = Literal["green", "infrared"]


def scene(kind: Kind, colour: Colour, seed: int, **changes: float) -> TrackScene:
    """One of the four settings of the source, with other values of :class:`TrackScene`.

    California's mountains or Missouri's plain; little signal and much noise, or the other way
    round.
    """
    ground = (
        {"relief_m": 500.0}
        if kind == "mountain"
        else {"relief_m": 8.0, "above_m": 300.0, "below_m": 300.0, "patch": 1.0}
    )
    light = (
        {"signal_per_m": 1.5, "noise_per_m2": 0.02}
        if colour == "green"
        else {"signal_per_m": 4.0, "noise_per_m2": 0.01}
    )
    return TrackScene.model_validate({"seed": seed, **ground, **light, **changes})


def workflow(**changes: Any) -> TrackWorkflow:
    """Settings, all defaults but sections that are named."""
    given = {"track": {"photons": "none"}, "output": "none", **changes}
    return TrackWorkflow.model_validate(given)


class Labelled(NamedTuple):
    """Photons in the order given, and what is found of them."""

    photons: Photons
    columns: dict[str, NDArray[Any]]  #: As of :data:`spl_batch.altimetry.filter.track.COLUMNS`.
    cells: dict[str, NDArray[Any]]

    @property
    def kept(self) -> Mask:
        """Photons that are signal."""
        return self.columns["signal"] > 0


def labelled(photons: Photons, settings: TrackWorkflow) -> Labelled:
    """Label a beam as the tasks of a run do."""
    along, height = photons
    order = np.lexsort((height, along))
    size = window_quanta(settings)
    span = int(along.min()) // size * size, (int(along.max()) // size + 1) * size
    found, cells = label(along[order], height[order], span, settings)
    columns = {}
    for name, values in found.items():
        columns[name] = np.empty_like(values)
        columns[name][order] = values
    return Labelled(photons, columns, cells)


def profile(beam: Labelled, settings: TrackWorkflow, layout: str = "csv") -> dict[str, Any]:
    """Columns of the profile of a beam."""
    some = np.flatnonzero(beam.columns["ground"] > 0)
    along, height = beam.photons
    some = some[np.lexsort((height[some], along[some]))]
    photons = along[some], height[some], beam.kept[some]
    level = beam.columns["level"][some].astype(np.int64)
    layers = layers_of(settings.profile, layout)
    return over_water.profile(photons, level, (-(10**9), 10**9), layers, 0.0)


def lattice(along_m: NDArray[np.float64], height_m: NDArray[np.float64]) -> Photons:
    """Photons on the lattice."""
    whole = [np.rint(v * QUANTA_PER_M) for v in (along_m, height_m)]
    return whole[0].astype(np.int64), whole[1].astype(np.int32)


MEASURES = (
    "precision", "recall", "F1", "photons RMSE", "profile RMSE", "cells", "in 1 sigma", "in 2 sigma"
)  # fmt: skip
"""RMSE [m]; share of cells with a ground, and of those whose error is as small as is estimated."""


def measures(track: Track, settings: TrackWorkflow) -> list[float]:
    """As :data:`MEASURES` names them."""
    beam = labelled(lattice(track.along_m, track.height_m), settings)
    kept, signal = beam.kept, track.truth > 0
    both = int(np.count_nonzero(kept & signal))
    kept_count, signal_count = int(np.count_nonzero(kept)), int(np.count_nonzero(signal))
    off = (track.height_m - track.ground_m)[kept]
    columns = profile(beam, settings)
    error = columns["ground"] - np.interp(columns["along_track"], *track.reference_m.T)
    known = np.isfinite(error)
    return [
        both / max(kept_count, 1),
        both / signal_count,
        2 * both / max(kept_count + signal_count, 1),
        float(np.sqrt(np.mean(off**2))) if len(off) else np.nan,
        float(np.sqrt(np.mean(error[known] ** 2))) if known.any() else np.nan,
        np.count_nonzero(known) / (track.along_m.max() / settings.profile.cell_m),
        *((np.abs(error) < n * columns["ground_error"])[known].mean() for n in (1.0, 2.0)),
    ]
