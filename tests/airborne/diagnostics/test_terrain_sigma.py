"""Terrain that is known poorly: its share, and its largest place."""

from types import SimpleNamespace

import numpy as np
import pytest

from spl_batch.airborne.diagnostics.terrain_sigma import (
    FACT,
    terrain_facts,
    terrain_findings,
    unsure_share,
)
from spl_batch.constants import NODATA
from spl_batch.lattice.tiles import Bounds

CORE = Bounds(200_000, 400_000, 300_000, 500_000)


def facts(*places):
    """A cell of 100 m; rows and columns of each place that is known poorly."""
    dtm = np.full((100, 100), 20.0, np.float32)
    quality = np.full((100, 100), 0.05, np.float32)
    dtm[:, :10] = quality[:, :10] = NODATA
    for rows, columns in places:
        quality[rows, columns] = 0.8
    return terrain_facts(quality, dtm, CORE)


def found(*cells):
    return {"surface": {str(k): SimpleNamespace(facts=one) for k, one in enumerate(cells)}}


def test_the_largest_place_is_a_fact_with_its_box():
    one = facts((slice(0, 5), slice(20, 24)), (slice(40, 60), slice(50, 62)))
    assert one[FACT] == [9000, 260, 240.0, 250.0, 440.0, 262.0, 460.0]
    assert facts()[FACT] == [9000, 0]


def test_a_large_place_or_a_large_share_is_a_finding():
    sound, small = facts(), facts((slice(0, 10), slice(20, 30)))
    large = facts((slice(40, 60), slice(50, 76)))
    assert not [*terrain_findings(found(sound))]
    assert not [*terrain_findings(found(sound, small))]
    (one,) = terrain_findings(found(sound, sound, large))
    assert (one.code, one.values["area_m2"]) == ("G01", 520.0)
    assert one.place == [250.0, 440.0, 276.0, 460.0]
    scattered = facts(*((slice(k, k + 1), slice(20, 60)) for k in range(0, 20, 2)))
    (one,) = terrain_findings(found(scattered))
    assert one.values["share"] == pytest.approx(400 / 9000)
    assert unsure_share(found(scattered)) == pytest.approx(400 / 9000)
    assert unsure_share(found()) is None
