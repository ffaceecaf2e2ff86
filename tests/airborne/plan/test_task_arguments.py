"""What a plan says of a task is what is done, and which tasks a setting makes again."""

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
import shapely
from pyproj import CRS

from spl_batch.airborne.context import Context
from spl_batch.airborne.plan import delivery_tasks
from spl_batch.airborne.plan.inputs.survey_inputs import gather_inputs
from spl_batch.airborne.products.product_table import (
    NAMES,
    REFLECTANCE,
    products,
)
from spl_batch.airborne.settings import NoiseSettings, OutputSettings
from spl_batch.airborne.settings.workflow import load_workflow
from spl_batch.airborne.steps import STEPS
from spl_batch.airborne.store import label_tables
from spl_batch.airborne.tasks import space_domain, surfaces
from spl_batch.lattice.tiles import Bounds, grow
from tests import surveys
from tests.formats.test_geoid import write_grid

CORE = Bounds(0, 0, 100_000, 100_000)


class ReadError(Exception):
    """Ends a task where it would read its points."""


@pytest.mark.parametrize("kind", ["denoise", "ground", "surface"])
@pytest.mark.parametrize("halo", [12_000, 56_789])
def test_a_task_reads_as_far_as_its_plan_says(
    kind: str, halo: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    regions = []

    def read(_store: Any, _cells: Any, region: Bounds, *_: Any, **__: Any) -> None:
        regions.append(region)
        raise ReadError

    tasks = surfaces if kind == "surface" else space_domain
    monkeypatch.setattr(label_tables, "read_region", read)
    workflow = load_workflow(surveys.write_workflow(tmp_path))
    context = Context(workflow, tmp_path, tmp_path / "out", "", "code")
    args = {
        "core": list(CORE), "tiles": [], "halo": halo, "cell": "0_0",
        "labels": {"denoise": [], "ground": []}, "aligned": False,
        "fired": None, "voxels": [], "beamlets": 1,
    }  # fmt: skip
    with pytest.raises(ReadError):
        getattr(tasks, kind)(args, context)
    assert regions == [grow(CORE, halo)]


def mosaics(monkeypatch: pytest.MonkeyPatch, *, reflectance: bool) -> dict[str, dict[str, Any]]:
    """Arguments of the mosaics of a survey."""
    monkeypatch.setattr(delivery_tasks, "mosaic_bounds", lambda _: CORE)
    monkeypatch.setattr(delivery_tasks, "knows_reflectance", lambda _: reflectance)
    workflow = SimpleNamespace(products=SimpleNamespace(cell_m=1.0))
    grid = SimpleNamespace(squares=lambda cell: [cell])
    survey: Any = SimpleNamespace(of=lambda _: ["0_0"], workflow=workflow, grid=grid)
    return {task.name: dict(task.args) for task in delivery_tasks.mosaic(survey)}


@pytest.mark.parametrize("reflectance", [False, True])
def test_a_mosaic_says_what_it_holds(monkeypatch: pytest.MonkeyPatch, reflectance: bool) -> None:  # noqa: FBT001
    found = mosaics(monkeypatch, reflectance=reflectance)
    assert tuple(found) == NAMES
    for product in products(reflectance=reflectance):
        args = found[product.name]
        assert args.items() >= product._asdict().items()
    assert (found["intensity"]["meaning"] == REFLECTANCE.meaning) is reflectance
    assert [name for name in NAMES if not found[name]["delivered"]] == ["noise"]


def test_another_grid_of_the_same_name_makes_heights_above_it_again(tmp_path: Path) -> None:
    grid = tmp_path / "a.gtx"
    geoid = {"grid": write_grid(grid)}
    workflow = load_workflow(surveys.small_survey(tmp_path, outputs={"geoid": geoid}))

    def planned() -> list[dict[str, Any]]:
        inputs = gather_inputs(workflow, tmp_path, tmp_path / "out")
        survey: Any = SimpleNamespace(workflow=workflow, inputs=inputs, of=lambda _: ["dsm", "dtm"])
        return [dict(task.args) for task in delivery_tasks.deliver_geoid(survey)]

    before = planned()
    assert len(before) == 2
    assert planned() == before
    grid.write_bytes(grid.read_bytes()[:-4] + bytes(4))
    assert all(old != new for old, new in zip(before, planned(), strict=True))


@pytest.mark.parametrize(
    ("outputs", "kinds"),
    [
        ({}, ("mosaic", "deliver_geoid")),
        ({"cell": 3.0}, ("reproject_raster", "deliver_geoid")),
        ({"units": "us-ft"}, ("reproject_raster",)),  # heights above a geoid stay in metres
        ({"crs": "EPSG:32614"}, ("mosaic", "deliver_geoid")),
    ],
)
def test_a_clients_tiles_are_cut_out_of_rasters_in_one_unit(
    monkeypatch: pytest.MonkeyPatch, outputs: dict[str, Any], kinds: tuple[str, ...]
) -> None:
    seen: list[tuple[str, ...]] = []

    def delivered_rasters(_: Any, kinds: tuple[str, ...]) -> tuple[list[str], list[Any]]:
        seen.append(kinds)
        return [], []

    monkeypatch.setattr(delivery_tasks, "delivered_rasters", delivered_rasters)
    monkeypatch.setattr(delivery_tasks, "aligned", lambda _: ())
    monkeypatch.setattr(delivery_tasks, "mosaic_bounds", lambda _: CORE)
    settings = OutputSettings(client_tiles={"polygons": "a.gpkg"}, **outputs)
    inputs = SimpleNamespace(
        crs=CRS("EPSG:32615+5703"), areas=[SimpleNamespace(name="A", shape=shapely.box(0, 0, 9, 9))]
    )
    survey: Any = SimpleNamespace(
        of=lambda _: {}, workflow=SimpleNamespace(outputs=settings), inputs=inputs,
        tile_q=100_000, counts={}, memory_bytes=0,
    )  # fmt: skip
    (task,) = delivery_tasks.deliver_client_tile(survey)
    assert seen == [kinds]
    assert task.args["in_another_unit"] == ("units" in outputs)


@pytest.mark.parametrize("kind", ["sights", "observe", "fit_line", "scatter"])
def test_the_time_domain_depends_on_all_of_the_noise_but_haze(kind):
    keys = {key.removeprefix("noise.") for key in STEPS[kind].settings if key.startswith("noise")}
    assert keys == set(NoiseSettings.model_fields) - {"haze"}


@pytest.mark.parametrize("kind", ["index_part", "sights", "observe", "fit_line", "scatter"])
def test_what_reads_channels_depends_on_where_they_are(kind):
    assert "survey.channel_dimension" in STEPS[kind].settings


def test_the_filter_depends_on_haze():
    assert "noise" in STEPS["denoise"].settings
