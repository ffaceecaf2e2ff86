"""Inputs that change: while a run goes on, between runs, and by one more of them."""

import json
import os
from collections import Counter
from collections.abc import Callable
from pathlib import Path

import pytest
import shapely
import shapely.geometry

from spl_batch import api
from spl_batch.engine.tasks.input_changes import unchanged
from spl_batch.engine.watch.events import Event, PhaseStarted, TaskEnded
from spl_batch.errors import InputError
from tests import surveys

GROUND = {"cell_m": 50, "buffer_m": 5}
SETTINGS = ("tiling.tile_m=10", "tiling.block_tiles=1")
FAR_M = 150.0


def line(folder: Path, number: int, *, east_m: float = 0.0, seed: int = 0) -> Path:
    west, south = surveys.ORIGIN_M
    columns = surveys.flightline(
        shots=40,
        psid=number,
        seed=seed or number,
        start_s=surveys.START_S + 3 * number,
        origin_m=(west + east_m, south),
    )
    return surveys.write_cloud(folder / "lines" / f"{number}.laz", columns)


@pytest.fixture
def survey(tmp_path: Path) -> Path:
    line(tmp_path, 1)
    line(tmp_path, 2, east_m=FAR_M)
    return surveys.write_workflow(tmp_path, ground=GROUND)


def clean(survey: Path) -> dict[str, bytes]:
    copied = surveys.copy_of(survey, survey.parent / "clean")
    return surveys.results(surveys.run(copied, *SETTINGS, until="deliver").output)


def counting(survey: Path, *overrides: str, until: str = "deliver") -> Counter[str]:
    done: Counter[str] = Counter()

    def listen(event: Event) -> None:
        if isinstance(event, TaskEnded):
            done[event.kind] += 1

    api.run(survey, workers=0, until=until, overrides=[*SETTINGS, *overrides], listener=listen)
    return done


def other(path: Path) -> None:
    line(path.parents[1], int(path.stem), east_m=FAR_M, seed=77)


@pytest.mark.parametrize(("kind", "change"), [("observe", other), ("deliver_file", Path.unlink)])
def test_a_file_that_changes_during_the_run_is_named_and_read_anew_by_the_next(
    survey: Path, kind: str, change: Callable[[Path], None]
) -> None:
    path = survey.parent / "lines" / "2.laz"
    before = path.read_bytes()

    def listen(event: Event) -> None:
        if isinstance(event, PhaseStarted) and event.kind == kind:
            change(path)

    reasons: list[TaskEnded] = []

    def both(event: Event) -> None:
        listen(event)
        if isinstance(event, TaskEnded) and event.reason:
            reasons.append(event)

    result = api.run(survey, workers=0, until="deliver", overrides=SETTINGS, listener=both)
    assert result.exit_status == 1
    assert reasons
    assert all(str(path) in r.reason and "run again" in r.reason for r in reasons)
    assert {r.kind for r in reasons} <= {kind, "deliver_file"}
    delivered = [p.name for p in (result.output / "laz" / "lines").iterdir()]
    assert delivered == ["1.laz"], "nothing mixed is left, the other file is whole"
    if not path.exists():
        path.write_bytes(before)
    again = surveys.run(survey, *SETTINGS, until="deliver")
    assert again.exit_status == 0
    assert surveys.results(again.output) == clean(survey)


def test_a_file_is_looked_at_before_and_after(tmp_path: Path) -> None:
    path = tmp_path / "a"
    path.write_bytes(b"1")
    stat = path.stat()
    stamp = [stat.st_size, stat.st_mtime_ns]
    with unchanged(path, stamp):
        pass
    with pytest.raises(InputError, match="changed"), unchanged(path, stamp):
        os.utime(path, ns=(0, stat.st_mtime_ns + 1))
    with pytest.raises(InputError, match="changed"), unchanged(path, stamp):
        pytest.fail("not read at all")


def test_one_more_flightline_redoes_the_tiles_that_it_touches(survey: Path) -> None:
    first = counting(survey)
    line(survey.parent, 3, east_m=FAR_M)
    more = counting(survey)
    everything = counting(survey, "products.void_max_m=19")
    assert more["index_file"] == more["observe"] == more["scatter"] == 1
    for kind in ("build_tile", "denoise", "ground", "surface"):
        assert 0 < more[kind] < first[kind], f"{kind}: the far half of the survey stays"
    assert more["deliver_file"] == 2, "the line far away has no new neighbour"
    assert everything["surface"] == first["surface"]
    output = survey.parent / "out"
    assert counting(survey)["surface"] == first["surface"], "and back"
    assert surveys.results(output) == clean(survey)


def test_polygons_are_known_by_their_content(survey: Path) -> None:
    west, south = surveys.ORIGIN_M
    path = survey.parent / "aoi.geojson"
    corners = [(west, south - 99), (west + 199, south - 99), (west + 199, south + 99)]
    crs = {"type": "name", "properties": {"name": "urn:ogc:def:crs:EPSG::32615"}}
    geometry = shapely.geometry.mapping(shapely.Polygon(corners))
    feature = {"type": "Feature", "properties": {}, "geometry": geometry}
    text = json.dumps({"type": "FeatureCollection", "crs": crs, "features": [feature]})
    path.write_text(text)
    counting(survey, "aoi=aoi.geojson", until="shuffle")
    os.utime(path, ns=(0, 0))
    assert not counting(survey, "aoi=aoi.geojson", until="shuffle")
    path.write_text(text.replace(f"{south - 99}", f"{south - 98}"))
    assert counting(survey, "aoi=aoi.geojson", until="shuffle")["scatter"] == 2
