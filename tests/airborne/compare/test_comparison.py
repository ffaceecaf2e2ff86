"""Several filters side by side: the numbers, the page, and that nothing is done twice."""

import json
import os
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from spl_batch import api
from spl_batch.airborne.compare.comparison import METHODS as METHODS_COMPARED
from spl_batch.airborne.compare.comparison import ComparisonReport, MethodResult
from spl_batch.airborne.compare.contrast import Contrast, _far, _fullest_strip
from spl_batch.airborne.report.model import DeliveredUnits
from spl_batch.airborne.settings.workflow import parse_workflow
from spl_batch.constants import US_FOOT_M
from spl_batch.engine.report.number_format import as_ascii
from spl_batch.engine.report.page import write_comparison
from spl_batch.engine.store.working_store import Store, read_receipt, write_receipt
from spl_batch.engine.tasks.task import Receipt
from spl_batch.engine.verbs.comparing import folder_of, listed, share_finished
from spl_batch.engine.watch.events import TaskEnded
from spl_batch.formats.units import Units
from spl_batch.lattice.tables import PointTable
from spl_batch.lattice.tiles import Bounds
from tests import surveys

METHODS = "vsaes:calibrated,dcc,published"


@pytest.fixture(scope="module")
def compared(tiny_survey: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Output of a comparison on the tiny survey, by the command line."""
    workflow = surveys.copy_of(tiny_survey, tmp_path_factory.mktemp("compared"))
    ended = surveys.command("compare", workflow, "--methods", METHODS, "--workers", 0)
    assert ended.status == 0, ended.text
    assert "compare.html" in ended.out
    return workflow.parent / "out"


def table(output: Path) -> dict[str, dict[str, Any]]:
    content = json.loads((output / "compare.json").read_text())
    return {method["name"]: method for method in content["methods"]}


def noise_classes(output: Path, folder: str) -> np.ndarray[Any, np.dtype[np.uint8]]:
    """Label of every point, in the order of the input files."""
    clouds = surveys.delivered(output / "compare" / folder)
    return np.concatenate([clouds[name]["noise_class"] for name in sorted(clouds)])


@pytest.mark.slow
def test_the_table_says_what_the_clouds_hold(compared: Path) -> None:
    methods = table(compared)
    assert list(methods) == METHODS.split(",")
    first = noise_classes(compared, "vsaes-calibrated")
    for name, method in methods.items():
        classes = noise_classes(compared, name.replace(":", "-"))
        assert method["points"] == len(classes)
        found = [method[k] for k in ("signal", "background", "afterpulse")]
        assert found == [np.count_nonzero(classes == k) for k in range(3)]
        known = (first != 255) & (classes != 255)
        assert method["kept_only"] == np.count_nonzero(known & (classes == 0) & (first != 0))
        assert method["removed_only"] == np.count_nonzero(known & (classes != 0) & (first == 0))
        assert 0 < method["removed_share"] < 1
        assert method["dtm_rmse_m"] > 0
        assert method["s_per_million"] > 0
        assert 0 <= method["far_share"] < 0.2
    assert methods["dcc"]["kept_only"] > 0
    assert methods["dcc"]["removed_only"] > 0
    # Its time domain is its own: no afterpulses are called in it.
    assert methods["published"]["afterpulse"] == 0 < methods["dcc"]["afterpulse"]


@pytest.mark.slow
def test_what_methods_share_is_done_once(compared: Path) -> None:
    shared, own = compared / "store" / "tiles", compared / "compare" / "vsaes-calibrated" / "store"
    for tile in shared.glob("*.parquet"):
        assert tile.samefile(own / "tiles" / tile.name)
        dcc = compared / "compare" / "dcc" / "store" / "tiles" / tile.name
        assert not tile.samefile(dcc)
    seen: list[Any] = []
    again = api.compare(
        compared.parent / "workflow.yaml", ["dcc", "published", "none"], workers=0,
        listener=seen.append,
    )  # fmt: skip
    assert again.exit_status == 0
    # Nothing but the new method's own tasks, from the denoising on.
    kinds = {event.kind for event in seen if isinstance(event, TaskEnded)}
    own_tasks = {"denoise", "ground", "surface", "strip_patches", "strip_pairs", "mosaic"}
    reported = {"reference", "accuracy", "checkpoints", "deliver_catalogue"}
    assert kinds == {*own_tasks, "deliver_file", *reported}
    none = again.report.methods[-1]
    assert none.background == 0
    assert none.far_share == 1.0


def test_methods_are_listed_once_and_have_folders() -> None:
    found = listed("vsaes:calibrated, voxel ,vsaes,voxel,published")
    assert found == ["vsaes:calibrated", "voxel", "vsaes", "published"]
    assert [folder_of(name) for name in found[:2]] == ["compare/vsaes-calibrated", "compare/voxel"]


def test_table_and_page_are_in_the_unit_of_delivery(tmp_path: Path) -> None:
    counts = dict.fromkeys(("points", "signal", "background", "afterpulse", "ground"), 10)
    one = MethodResult(
        name="aes", folder="compare/aes", kept_only=0, removed_only=0, dtm_rmse_m=0.061,
        dsm_nmad_m=0.122, **counts,
    )  # fmt: skip
    units = Units("US survey foot", US_FOOT_M, "US survey foot", US_FOOT_M)
    report = ComparisonReport(
        version="1", survey="county", units=DeliveredUnits(**asdict(units)), photons=True,
        far_m=50.0, methods=(one,),
    )  # fmt: skip
    row = dict(zip(METHODS_COMPARED.titles, METHODS_COMPARED.row(report, one), strict=True))
    assert row["DTM RMSE"] == "0.200 ft (6.1 cm)"
    assert row["DSM NMAD"] == "0.400 ft (12.2 cm)"
    write_comparison(tmp_path, report, "compare.html.j2", "spl_batch.airborne.compare", [])
    page = as_ascii((tmp_path / "compare.html").read_text())
    assert "<td>0.200 ft (6.1 cm)</td>" in page
    metric = report.model_copy(update={"units": DeliveredUnits()})
    assert "6.1 cm" in METHODS_COMPARED.row(metric, one)


def test_rules_for_afterpulses_can_be_compared() -> None:
    settings = parse_workflow({"survey": {"flightlines": "a"}, "output": "o"}, "w")
    for rule in ("beamlet", "published"):
        keys = METHODS_COMPARED.keys(f"afterpulse:{rule}", settings)
        assert keys == ("afterpulse.enabled=true", f"afterpulse.method={rule}")
    assert METHODS_COMPARED.keys("afterpulse:none", settings) is None


@pytest.mark.parametrize(
    "methods",
    [
        "voxels,aes",
        "foo",
        "voxel:calibrated,aes",
        "published:calibrated,aes",
        "vsaes:best,aes",
        "aes,,aes",
    ],
)
def test_a_wrong_list_names_what_there_is(methods: str, small_lines: Path) -> None:
    ended = surveys.command("compare", small_lines, "--methods", methods)
    assert ended.status == 2
    assert ended.err.strip().startswith("spl-batch: --methods: ")
    assert "vsaes, aes, dcc, pixels, voxel, multilevel, cylinder, none" in ended.err
    wrong = [
        name
        for name in ("voxels", "foo", "voxel:calibrated", "published:calibrated")
        if name in methods
    ]
    assert not wrong or f"no method {wrong[0]!r}" in ended.err
    assert len(ended.err.strip().splitlines()) == 1
    assert not (small_lines.parent / "out").exists()


def test_far_is_counted_against_plain_numpy() -> None:
    rng = np.random.default_rng(2)
    ground = rng.uniform(0, 1, (20_000, 3)) * [20, 10, 0.1] + [0, 0, 102]
    noise = rng.uniform(0, 1, (6000, 3)) * [20, 10, 240]
    # One column more, which holds nothing but noise: no scene, so nothing is far from it.
    bare = rng.uniform(0, 1, (300, 3)) * [10, 10, 240] + [0, 10, 0]
    xyz = np.floor(np.concatenate([ground, noise, bare]) * 1000).astype(np.int64)
    points = PointTable({}).with_columns(x=xyz[:, 0], y=xyz[:, 1], z=xyz[:, 2])
    kept = rng.random((2, len(xyz))) < [[0.5], [0.01]]
    zeros = np.zeros(2, dtype=np.int64)
    found = Contrast(zeros.copy(), zeros.copy(), zeros.copy(), 0, 0.0, None, [])
    far = _far(found, points, kept, Bounds(0, 0, 20_000, 20_000))
    scene = xyz[:, 2].min() / 1000 + 102.5  # bins start at the lowest point
    away = (xyz[:, 1] < 10_000) & (abs(xyz[:, 2] / 1000 - scene) > 50)
    np.testing.assert_array_equal(far, away | (xyz[:, 1] >= 10_000))
    assert found.far_points == away.sum() > 3000
    np.testing.assert_array_equal(found.far_kept, (kept & away).sum(axis=1))
    assert found.far_m3 == pytest.approx(200 * 140, rel=0.02)


def test_the_disputed_strip_holds_most_points() -> None:
    xyz = np.array([[1, 1, 0], [95, 34, 0], [97, 34, 0], [150, 34, 0], [30, 50, 0]]) * 1000
    points = PointTable({}).with_columns(x=xyz[:, 0], y=xyz[:, 1], z=xyz[:, 2])
    strip, count = _fullest_strip(points, Bounds(0, 0, 200_000, 200_000))
    assert count == 3
    assert strip == Bounds(54_000, 33_000, 154_000, 36_000)


@pytest.mark.parametrize("links", [True, False])
def test_stores_share_what_is_finished(
    links: bool,  # noqa: FBT001
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    if not links:

        def refuse(*_: object) -> None:
            raise OSError(18, "Invalid cross-device link")

        monkeypatch.setattr(os, "link", refuse)
    source, target = Store(tmp_path / "a"), Store(tmp_path / "b")
    for name, reason in (("one", ""), ("two", "failed")):
        source.path("voxels", name).parent.mkdir(parents=True, exist_ok=True)
        source.path("voxels", name).write_text(name)
        write_receipt(
            source,
            Receipt(
                "scatter", name, "k", "d", reason, {f"store/voxels/{name}": "x"}, {}, 1, 1.0, 1.0
            ),
        )
    share_finished(source, target, ["scatter", "sights"])
    assert target.path("voxels", "one").read_text() == "one"
    assert not target.path("voxels", "two").exists()
    assert read_receipt(target, "scatter", "one") == read_receipt(source, "scatter", "one")
    same = target.path("voxels", "one").samefile(source.path("voxels", "one"))
    assert same is links
    # What has changed since is shared anew; what has gone is not vouched for.
    changed = Receipt("scatter", "one", "k2", "d", "", {"store/gone": "x"}, {}, 1, 1.0, 1.0)
    write_receipt(source, changed)
    share_finished(source, target, ["scatter"])
    assert read_receipt(target, "scatter", "one") is None
