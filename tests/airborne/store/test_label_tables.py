"""Labels find their points again, however the units are cut."""

from pathlib import Path
from typing import Any

import numpy as np
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from spl_batch.airborne.store.label_tables import (
    GROUP_ROWS,
    Origin,
    label_files,
    read_region,
    units_within,
    write_labels,
)
from spl_batch.engine.store.working_store import Store
from spl_batch.engine.tasks.task import Receipt
from spl_batch.formats.verified.parquet_npz import write_table
from spl_batch.lattice.tables import CANONICAL_ORDER, COLUMNS, PointTable, canonical_order
from spl_batch.lattice.tiles import Bounds, CellId, cell_bounds, cell_index, cells_touching, inside

TILE = 100


def scene(n: int, seed: int) -> PointTable:
    rng = np.random.default_rng(seed)
    columns = {
        "x": rng.integers(-250, 250, n),
        "y": rng.integers(-250, 250, n),
        "z": rng.integers(-9, 9, n),
        "gps_time": rng.integers(0, 5, n),
        "channel": rng.integers(0, 5, n),
        "return_number": rng.integers(1, 3, n),
        "source": rng.integers(1, 3, n),
        "index": np.arange(n),
    }
    table = PointTable({k: v.astype(COLUMNS[k].dtype) for k, v in columns.items()})
    return table.take(canonical_order(table))


def write_tiles(store: Store, table: PointTable) -> list[CellId]:
    i, j = (cell_index(table[a], TILE) for a in "xy")
    tiles = sorted({CellId(a, b) for a, b in zip(i.tolist(), j.tolist(), strict=True)})
    for tile in tiles:
        write_table(store.table("tiles", str(tile)), table.take((i == tile.i) & (j == tile.j)))
    return tiles


@settings(
    max_examples=8, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(n=st.integers(1, 150), unit=st.sampled_from([70, 100, 260]), seed=st.integers(0, 99))
def test_labels_of_other_units_come_back_to_each_point(
    tmp_path_factory: object, n: int, unit: int, seed: int
) -> None:
    store = Store(tmp_path_factory.mktemp("store"))  # type: ignore[attr-defined]
    table = scene(n, seed)
    tiles = write_tiles(store, table)
    units = {u for t in tiles for u in cells_touching(cell_bounds(t, TILE), unit)}
    for u in units:
        core = cell_bounds(u, unit)
        near = [t for t in tiles if t in set(cells_touching(core, TILE))]
        found, origin = read_region(store, near, core, CANONICAL_ORDER, {})
        # The label is a function of the point alone, so that it can be recomputed.
        write_labels(store.table("ground", str(u)), origin, {"ground": found["index"] % 7})
    holders = [("ground", str(u)) for u in units]
    seen = 0
    for tile in tiles:
        back, _ = read_region(store, [tile], None, CANONICAL_ORDER, {"ground": holders})
        assert np.array_equal(back["ground"], back["index"] % 7)
        seen += len(back)
    assert seen == n
    region = Bounds(-120, -33, 155, 101)
    got, _ = read_region(store, tiles, region, CANONICAL_ORDER, {"ground": holders})
    mine = table.take(inside(table["x"], table["y"], region))
    assert np.array_equal(got["index"], mine["index"]), "canonical order, nothing lost"
    assert np.array_equal(got["ground"], mine["index"] % 7)


@settings(
    max_examples=8, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(n=st.integers(1, 150), seed=st.integers(0, 99), other=st.sampled_from([None, 0, 1]))
def test_points_as_they_lie_are_the_same_and_labelled_alike(
    tmp_path_factory: object, n: int, seed: int, other: int | None
) -> None:
    folder: Path = tmp_path_factory.mktemp("store")  # type: ignore[attr-defined]
    store = Store(folder)
    tiles = write_tiles(store, scene(n, seed))
    region = Bounds(-120, -33, 155, 101)
    paths, seen = [], []
    for number, ordered in enumerate((True, False)):
        table, origin = read_region(store, tiles, region, CANONICAL_ORDER, {}, ordered=ordered)
        value = table["index"] % 7
        half = np.arange(len(table)) % 2 == 0
        if other is not None and len(table) > 1:  # neither order: two neighbours changed places
            swap = np.arange(len(table))
            swap[[other, -1]] = swap[[-1, other]]
            origin = Origin(origin.tiles, origin.owner[swap], origin.row[swap])
            value = value[swap]
        paths.append(folder / f"{number}.parquet")
        order = np.arange(len(table)) if not number else np.argsort(half, kind="stable")
        write_labels(paths[-1], origin.of(order), {"ground": value[order]})
        seen.append(table["index"][canonical_order(table)].tolist())
    assert seen[0] == seen[1]
    assert paths[0].read_bytes() == paths[1].read_bytes()


def test_points_without_labels_say_so(tmp_path: Path) -> None:
    store = Store(tmp_path)
    table = scene(50, 1)
    tile = write_tiles(store, table)[0]
    names = ("noise_class", "p_value", "classification", "ground")
    back, _ = read_region(store, [tile], None, ("x",), dict.fromkeys(names, ()))
    assert np.all(back["noise_class"] == 255)
    assert np.all(back["classification"] == 255)
    assert np.all(back["ground"] == 0)
    assert np.all(np.isnan(back["p_value"]))


def labelled(
    tiles: NDArray[Any], rows: NDArray[Any], ground: NDArray[Any]
) -> tuple[Origin, dict[str, NDArray[Any]]]:
    named, owner = np.unique(tiles, axis=0, return_inverse=True)
    place = Origin(named.astype(np.int32), owner.ravel().astype(np.uint16), rows.astype(np.uint32))
    return place, {"ground": ground}


def labels_of(
    store: Store, unit: str, tile: CellId, rows: tuple[int, int] = (0, 2**32)
) -> dict[str, NDArray[Any]]:
    span = {"tile_i": (tile.i, tile.i), "tile_j": (tile.j, tile.j), "row": rows}
    return label_files(store)(("ground", unit)).between(span).read(["row", "ground"])[0]


def test_of_a_long_tile_only_the_rows_in_question_are_read(tmp_path: Path) -> None:
    store, count = Store(tmp_path), 3 * GROUP_ROWS + 5
    ground = (np.arange(count) % 5 == 0).astype(np.uint8)
    whole = np.arange(count, dtype=np.uint32)
    # Where rows are left out they are read; elsewhere they are counted.
    gaps = np.delete(whole, [4, 2 * GROUP_ROWS + 9])
    for unit, row in {"whole": whole, "gaps": gaps}.items():
        tiles = np.zeros((len(row), 2), np.int32)
        write_labels(store.table("ground", unit), *labelled(tiles, row, ground[row]))
        for low, high in ((0, 0), (GROUP_ROWS - 1, GROUP_ROWS), (3 * GROUP_ROWS, count - 1)):
            back = labels_of(store, unit, CellId(0, 0), (low, high))
            assert np.array_equal(back["ground"], ground[back["row"]])
            assert np.array_equal(np.intersect1d(back["row"], [low, high]), np.unique([low, high]))
            assert len(back["row"]) <= 2 * GROUP_ROWS


def test_each_footer_is_read_once(tmp_path: Path) -> None:
    store, tile = Store(tmp_path), CellId(0, 0)
    files = label_files(store)
    for k in range(3):
        path = store.table("ground", f"u{k}")
        write_labels(path, *labelled(np.array([tile]), np.array([0]), np.array([k])))
    for k in (0, 1, 2, 0):
        found = files(("ground", f"u{k}"))
        assert found is files(("ground", f"u{k}"))
        here, beside = (found.between({"tile_i": (at, at), "row": (0, 0)}) for at in (0, 1))
        assert here.read(["ground"])[0]["ground"].tolist() == [k]
        assert not beside.wanted


def test_no_tiles_make_an_empty_region(tmp_path: Path) -> None:
    table, origin = read_region(Store(tmp_path), [], Bounds(0, 0, 9, 9), CANONICAL_ORDER, {})
    assert len(table) == len(origin.row) == len(origin.owner) == 0


def test_units_of_a_region_are_those_that_own_some_of_it() -> None:
    cores = {"a": [0, 0, 100, 100], "b": [100, 0, 200, 100], "c": [200, 0, 300, 100]}
    receipts = {
        name: Receipt("ground", name, "", "", "", {}, {"core": core}, 0, 0.0, 0.0)
        for name, core in cores.items()
    }
    done = {"ground": receipts}
    assert units_within(Bounds(50, 10, 101, 20), ["ground"], done)["ground"] == [
        ("ground", k) for k in "ab"
    ]
    assert units_within(Bounds(100, 10, 200, 20), ["ground"], done) == {"ground": [("ground", "b")]}
