"""Heights of hard places that swing with time or follow brightness, against sums by hand."""

from types import SimpleNamespace
from typing import NamedTuple, cast

import numpy as np
import pytest
from spl_batch.airborne.report.fit.steady import steady_warnings

from spl_batch.airborne.context import Context
from spl_batch.airborne.pulses import steady_heights as steady
from spl_batch.airborne.pulses.level_places import places_in
from spl_batch.airborne.sensors.sensor import Sensor
from spl_batch.airborne.settings import ProductSettings
from spl_batch.airborne.tasks.cells import pulses
from spl_batch.lattice.tiles import Bounds

CORE = Bounds(0, 0, 48_000, 48_000)


class Returns(NamedTuple):
    xyz: np.ndarray
    line: np.ndarray
    time_s: np.ndarray
    brightness: np.ndarray

    def take(self, chosen):
        return Returns(*(values[chosen] for values in self))


def unsteady(returns, core=CORE):
    found = {}
    for places in places_in(returns.xyz, returns.line, core):
        more = steady.unsteady_places(places, returns.time_s, returns.brightness, 0.05)
        for line, counts in more.items():
            steady.add_counts(found, line, counts)
    return found


def survey(rng, swing_m=0.0, walk_m=0.0, rough_m=0.05, looks=6):
    """Two flightlines over a slope, each of looks a second apart."""
    n = 6000
    xy = rng.integers(0, 48_000, (2 * looks * n, 2))
    line = np.repeat([1, 2], looks * n)
    look = np.repeat(np.arange(2 * looks), n)
    electrons = 1 + rng.poisson(0.5, len(xy))
    z = 100 * xy[:, 0] // 1000 + 1000 * rng.normal(0, rough_m, len(xy))
    z += 1000 * (swing_m * rng.normal(0, 1, 2 * looks)[look] + walk_m * (1 - 1 / electrons))
    xyz = np.column_stack([xy, np.rint(z).astype(np.int64)])
    time_s = 7e8 + look + rng.uniform(0, 0.003, len(xy))
    bright = (8000 * electrons).astype(np.uint16)
    return Returns(xyz.astype(np.int64), line, time_s, bright)


def typical(returns):
    found = unsteady(returns)
    return {line: [steady.typical_m(counts[kind]) for kind in steady.KINDS]
            for line, counts in found.items()}  # fmt: skip


def test_what_swings_and_what_walks_is_found_by_flightline():
    rng = np.random.default_rng(1)
    for looks, bright in typical(survey(rng)).values():
        assert looks <= 0.01
        assert abs(bright) <= 0.01
    for looks, _ in typical(survey(rng, swing_m=0.1, looks=30)).values():
        assert looks == pytest.approx(0.1, abs=0.04)
    for _, bright in typical(survey(rng, walk_m=0.6)).values():
        assert bright == pytest.approx(0.33, abs=0.05)
    assert all(looks is None for looks, _ in typical(survey(rng, rough_m=0.2)).values())


def test_places_are_those_that_sums_by_hand_tell():
    rng = np.random.default_rng(2)
    some = survey(rng, swing_m=0.1, walk_m=0.2, rough_m=0.04)
    keep = rng.random(len(some.line)) < 0.1
    some = some.take(keep)
    order = rng.permutation(len(some.line))
    found = unsteady(some.take(order))
    looks = {1: [], 2: []}
    rises = {1: [], 2: []}
    for line in (1, 2):
        for x, y in np.ndindex(6, 6):
            there = (some.line == line) & (some.xyz[:, 0] // 8000 == x)
            there &= some.xyz[:, 1] // 8000 == y
            xyz = some.xyz[there].astype(float)
            plane = np.column_stack([np.ones(len(xyz)), xyz[:, :2]])
            slopes, *_ = np.linalg.lstsq(plane, xyz[:, 2], rcond=None)
            height = xyz[:, 2] - plane[:, 1:] @ slopes[1:]
            looks[line].append(by_hand(height, xyz, np.floor(some.time_s[there])))
            bright = some.brightness[there]
            weak = bright <= np.sort(bright)[(len(bright) - 1) // 2]
            if np.var(height[weak], ddof=1) <= 100.0**2:
                rises[line].append(height[~weak].mean() - height[weak].mean())
        for kind, places in (("looks", looks[line]), ("bright", rises[line])):
            values = np.repeat(*np.array(sorted(found[line][kind].items())).T)
            wanted = np.sort([one for one in places if one is not None]) / 10
            np.testing.assert_allclose(values, wanted, atol=0.51)


def by_hand(height, xyz, look):
    """Standard deviation of looks in a place [mm]; None where it is not hard."""
    between = within = free = own = reduced = 0.0
    for x, y in np.ndindex(4, 4):
        cell = (xyz[:, 0] % 8000 // 2000 == x) & (xyz[:, 1] % 8000 // 2000 == y)
        groups = [height[cell & (look == one)] for one in np.unique(look)]
        groups = [group for group in groups if len(group) >= steady.FEWEST]
        if len(groups) > 1:
            together = np.concatenate(groups)
            means = [group.mean() for group in groups]
            sizes = np.array([len(group) for group in groups])
            between += np.sum(sizes * (np.array(means) - together.mean()) ** 2)
            within += sum(((group - group.mean()) ** 2).sum() for group in groups)
            free, own = free + len(groups) - 1, own + len(together) - len(groups)
            reduced += len(together) - (sizes**2).sum() / len(together)
    if not own or within > own * 100.0**2:
        return None
    return np.sqrt(max((between - free * within / own) / reduced, 0.0))


def test_a_region_is_the_sum_of_its_parts():
    some = survey(np.random.default_rng(3), swing_m=0.1)
    whole = unsteady(some)
    parts = {}
    for part in (CORE._replace(xmax=16_000), CORE._replace(xmin=16_000)):
        for line, counts in unsteady(some, part).items():
            steady.add_counts(parts, line, counts)
    assert parts == whole


def test_they_are_told_with_number_and_remedy():
    def said(swing_m, walk_m):
        found = unsteady(survey(np.random.default_rng(4), swing_m, walk_m, looks=12))
        receipt = SimpleNamespace(facts={"steady": steady.as_facts(found)})
        return list(steady_warnings({"surface": {"a": receipt}}, (), 0.05))

    assert not said(0.0, 0.0)
    (text,) = said(0.15, 0.0)
    assert "recorded positions or angles swing" in text
    assert "flightlines (00001 without times, 00002 without times)" in text
    (text,) = said(0.0, 0.5)
    assert "lie 27 cm above" in text or "lie 28 cm above" in text


def test_of_flightlines_that_share_an_id_the_one_that_swings_is_told():
    starts = np.array([371_000_003, 371_000_243, 371_000_483])
    calm = survey(np.random.default_rng(5), looks=12)
    swings = survey(np.random.default_rng(6), swing_m=0.15, looks=12)
    swings = swings.take(swings.line == 1)._replace(line=np.full(12 * 6000, 3))
    three = Returns(*(np.concatenate(both) for both in zip(calm, swings, strict=True)))
    time_s = three.time_s % 1 + starts[three.line - 1] + np.tile(np.repeat(np.arange(12), 6000), 3)
    one_id = np.zeros(len(time_s), np.uint16)
    workflow = SimpleNamespace(
        products=ProductSettings(), classes=SimpleNamespace(overlap=False), water=None,
        sensor=Sensor(range_sigma_m=0.05),
    )  # fmt: skip
    cell = pulses.Pulses(CORE, [], cast("Context", SimpleNamespace(workflow=workflow)))
    xy = three.xyz[:, :2]
    cell.add(pulses.PulseReturns(three.xyz, xy, time_s, one_id, three.brightness), CORE)
    facts = cell.facts(cell.judged(np.ones((192, 192), np.bool_)))
    receipt = SimpleNamespace(facts=facts)
    flown = [(f"00000_{start}", 0, start, start + 30.0) for start in starts.tolist()]
    (text,) = steady_warnings({"surface": {"a": receipt}}, flown, 0.05)
    assert text.startswith("flightline 00000_371000483: heights of one and the same hard place")
