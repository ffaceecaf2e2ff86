"""Signal that fills the air or floats, on clouds whose truth is known."""

from types import SimpleNamespace

import numpy as np
import pytest

from spl_batch.airborne.diagnostics.air_fill import (
    ALONE,
    FILLED,
    FLOATS,
    air_findings,
    alone_facts,
    fill_facts,
    filled_blocks,
    float_facts,
    floating,
    highest_ground,
)
from spl_batch.airborne.filter.stray_returns import bare_cells
from spl_batch.airborne.settings import FilterSettings
from spl_batch.constants import NODATA, NOISE_BACKGROUND, NOISE_SIGNAL
from spl_batch.lattice.tables import PointTable
from spl_batch.lattice.tiles import Bounds

CORE = Bounds(600_000, 4_000_000, 680_000, 4_060_000)
DTM = np.full((60, 80), 20.0, np.float32)
NOISE_M3 = 0.02


def uniform(rng, per_m3, low_m, high_m, west_m=0.0, east_m=80.0):
    """Places in a layer above ground at 20 m."""
    count = rng.poisson(per_m3 * (east_m - west_m) * 60 * (high_m - low_m))
    low, high = (600 + west_m, 4000, 20 + low_m), (600 + east_m, 4060, 20 + high_m)
    return rng.uniform(low, high, (count, 3))


def ground(rng, per_m2=10.0):
    return uniform(rng, per_m2 / 0.1, -0.05, 0.05)


def crowns(rng, cover=0.5):
    """Turbid crowns of 4 m radius, 6 to 14 m above the ground."""
    air = uniform(rng, 3.0, 6.0, 14.0)
    centres = rng.uniform((600, 4000), (680, 4060), (int(cover * 4800 / 50), 2))
    near = np.hypot(*(air[:, None, :2] - centres).transpose(2, 0, 1)).min(axis=1) < 4.0
    return air[near]


def table(*clouds, kinds=None):
    xyz = np.rint(np.concatenate(clouds) * 1000).astype(np.int64)
    kind = np.full(len(xyz), NOISE_SIGNAL, np.uint8) if kinds is None else kinds
    return PointTable(
        {"x": xyz[:, 0], "y": xyz[:, 1], "z": xyz[:, 2].astype(np.int32), "noise_class": kind}
    )


def filled(*clouds, dtm=DTM):
    blocks = filled_blocks(table(*clouds), CORE, highest_ground(dtm), NOISE_M3)
    return fill_facts(blocks, CORE)[FILLED]


@pytest.mark.parametrize(
    ("low_m", "high_m"), [(0.0, 3.0), (8.0, 14.0), (20.0, 30.0), (55.0, 57.0), (90.0, 91.5)]
)
def test_air_that_signals_fill_is_found_with_its_heights_and_place(low_m, high_m):
    rng = np.random.default_rng(1)
    found = filled(ground(rng), crowns(rng, 0.1), uniform(rng, 1.5, low_m, high_m, 40.0, 80.0))
    area_m2, low, high, west, south, east, north = found
    assert area_m2 == pytest.approx(2400, rel=0.3)
    assert low == pytest.approx(low_m, abs=2.0)
    assert high == pytest.approx(high_m, abs=2.0)
    assert west >= 630.0
    assert (east, south, north) == (680.0, 4000.0, 4060.0)


@pytest.mark.parametrize("cover", [0.3, 0.6, 1.2])
def test_crowns_fill_no_air(cover):
    rng = np.random.default_rng(2)
    assert filled(ground(rng), crowns(rng, cover)) == []


def test_a_roof_a_wire_and_noise_fill_none():
    rng = np.random.default_rng(3)
    bare = ground(rng)
    bare = bare[(bare[:, 0] < 620) | (bare[:, 0] > 660)]
    roof = uniform(rng, 100.0, 8.0, 8.1, 20.0, 60.0)
    wires = np.column_stack([rng.uniform(600, 680, 2000), 4000 + 2.0 * rng.integers(0, 30, 2000),
                             rng.normal(45, 0.05, 2000)])  # fmt: skip
    assert filled(bare, roof, wires, uniform(rng, NOISE_M3, 1.0, 100.0)) == []


def test_strips_of_a_cell_are_judged_as_the_whole():
    rng = np.random.default_rng(5)
    cloud, highest = table(ground(rng), uniform(rng, 1.0, 10.0, 20.0)), highest_ground(DTM)
    whole = filled_blocks(cloud, CORE, highest, NOISE_M3)
    parts = []
    for west, east in ((600, 640), (640, 680)):
        part = CORE._replace(xmin=1000 * west, xmax=1000 * east)
        own = cloud.take((cloud["x"] >= part.xmin) & (cloud["x"] < part.xmax))
        parts.append(filled_blocks(own, part, highest[:, west - 600 : east - 600], NOISE_M3))
    assert whole.any()
    assert np.array_equal(np.concatenate(parts, axis=1), whole)


def test_what_hangs_high_above_a_surface_floats_unless_it_is_a_thin_roof():
    kept = np.zeros((9, 9, 12), np.int64)
    kept[:, :, 0] = 50
    kept[2:4, 2:4, 6:9] = 20
    kept[6, 6, 7] = 40
    found = floating(kept, np.zeros(kept.shape, np.bool_))
    assert found[2:4, 2:4].tolist() == [[60, 60], [60, 60]]
    assert found.sum() == 240, "a thin roof of as many returns as the ground is a surface"
    stray = kept == 50
    assert floating(kept, stray).sum() == 0, "above nothing nothing floats"


def test_floating_signal_is_a_fact_with_area_and_place():
    rng = np.random.default_rng(7)
    lower, cloud = ground(rng), uniform(rng, 0.2, 60.0, 80.0, 40.0, 80.0)
    refused = uniform(rng, 0.05, -40.0, 100.0)
    kinds = np.full(len(lower) + len(cloud) + len(refused), NOISE_SIGNAL, np.uint8)
    kinds[-len(refused) :] = NOISE_BACKGROUND
    bare = bare_cells(table(lower, cloud, refused, kinds=kinds))
    count, kept, area_m2, west, south, east, north = float_facts(bare, CORE)[FLOATS]
    assert count == pytest.approx(len(cloud), abs=5)
    assert kept == pytest.approx(len(cloud) + len(lower), abs=5)
    assert area_m2 == pytest.approx(2400, rel=0.1)
    assert (west, south, east, north) == (640.0, 4000.0, 680.0, 4060.0)


def test_returns_that_the_surface_model_rises_to_alone_are_named():
    dtm = np.full((20, 20), 10.0, np.float32)
    dsm = dtm + 2.0
    dsm[4:8, 4:8] = 400.0  # a tower: each of its cells has others beside it
    dsm[0, 0] = dsm[12, 12] = 131.0
    assert alone_facts(dsm, dtm) == {}
    dsm[15, 3], dsm[19, 19], dsm[1, 15:17] = 900.0, 1010.0, 140.0
    assert alone_facts(dsm, dtm) == {ALONE: [4.0, 1000.0]}
    dtm[19, 19] = NODATA
    dsm[4, 15] = NODATA
    (one,) = air_findings(receipts([alone_facts(dsm, dtm)]), FilterSettings())
    assert (one.code, one.values["count"], one.values["highest_m"]) == ("N07", 3, 890.0)


def receipts(surface=(), grounds=()):
    def named(facts):
        return {f"{k}_0": SimpleNamespace(facts=one) for k, one in enumerate(facts)}

    return {"surface": named(surface), "ground": named(grounds)}


def test_findings_are_of_cells_that_are_filled_or_float_enough():
    settings = FilterSettings()
    box = [0.0, 0.0, 50.0, 50.0]
    fills = receipts([{FILLED: [1200.0, 2.0, 8.0, *box]}, {FILLED: []}])
    (one,) = air_findings(fills, settings)
    assert (one.code, one.subject, one.values["area_m2"]) == ("N04", "0_0", 1200.0)
    floats = [{FLOATS: [300, 10_000, 400.0, *box]}, {FLOATS: [300, 10_000, 200.0, *box]}]
    found = air_findings(receipts((), floats), settings)
    assert [one.code for one in found] == ["N07", "N07"]
    assert not [*air_findings(receipts((), floats[:1]), settings)], "a small area"
    few = [{FLOATS: [30, 10_000, 900.0, *box]}, {FLOATS: [0, 0]}]
    assert not [*air_findings(receipts((), few), settings)], "a small share"
