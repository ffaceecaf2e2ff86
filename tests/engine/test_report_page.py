"""Pages of reports: structure, parameters, maps; and records that another version has left."""

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from spl_batch.airborne.settings.workflow import parse_workflow
from spl_batch.engine.report import maps, style
from spl_batch.engine.report.maps import Raster
from spl_batch.engine.report.page import changed
from spl_batch.engine.tasks.runner import code_version
from spl_batch.engine.verbs import reporting
from spl_batch.errors import StoreError

EXTENT = (500_000.0, 500_400.0, 3_300_000.0, 3_300_300.0)


def test_only_what_differs_is_shown() -> None:
    given = {"kind": "imaging", "survey": {"flightlines": ["x" * 500]}, "output": "o"}
    given |= {"products": {"cell_m": 0.5}, "ground": {"method": "smrf"}}
    found = dict(changed(parse_workflow(given, "w").model_dump(mode="json")))
    assert found.keys() == {"survey.flightlines", "output", "products.cell_m", "ground.method"}
    assert (found["products.cell_m"], found["ground.method"]) == ("0.5", "smrf")
    assert len(found["survey.flightlines"]) < 200
    assert not dict(changed({"kind": "of another version"}))


@pytest.mark.parametrize("extent", [EXTENT, (0.0, 5.0, 0.0, 900.0), (0.0, 900.0, 0.0, 5.0)])
def test_maps_have_coordinates_a_unit_and_the_same_bytes(extent: maps.Extent) -> None:
    rng = np.random.default_rng(0)
    raster = Raster(rng.random((30, 40)), extent, (extent[0], extent[2], extent[1], extent[3]))
    drawn = maps.draw_relief(raster, "Terrain", "height [m]")
    axes, bar = drawn.axes
    assert axes.get_title("left") == "Terrain"
    assert axes.get_xlim() == extent[:2]
    assert "height [m]" in {bar.get_ylabel(), bar.get_xlabel()}
    png, width, _ = style.to_png(drawn)
    assert width == pytest.approx(maps.WIDTH_IN * style.DPI)
    again = maps.draw_relief(raster, "Terrain", "height [m]")
    assert style.to_png(again)[0] == png
    maps.draw_ramp(raster, "t", "u", ramp=style.SKY, limits=(0.0, 1.0))


@pytest.mark.parametrize("same", [True, False])
def test_records_of_another_version_are_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, *, same: bool
) -> None:
    def fails(*_: object) -> None:
        raise KeyError("a fact")

    code = code_version("imaging") if same else "0.0.9+0123456789abcdef"
    context = SimpleNamespace(code=code, workflow=SimpleNamespace(kind="imaging"), output=tmp_path)
    monkeypatch.setattr(reporting, "refuse_no_output", lambda *_: None)
    monkeypatch.setattr(reporting, "recalled", lambda _: ({}, context, None))
    monkeypatch.setattr(reporting, "summariser", lambda _: fails)
    # a fault of this version's own is no other's
    with pytest.raises(KeyError if same else StoreError):
        reporting.report(tmp_path)
