"""What all looks at a surface cell share holds the columns of each."""

from types import SimpleNamespace
from typing import Any

import pytest

from spl_batch.airborne.products import surface_rasters
from spl_batch.airborne.products.reflectance import reflectance
from spl_batch.airborne.settings.workflow import Workflow
from spl_batch.airborne.tasks.surfaces import _columns


@pytest.mark.parametrize(
    ("fired", "needed"),
    [
        (None, surface_rasters.COLUMNS_OF_INTENSITY),
        ([], reflectance.COLUMNS_NEEDED),
    ],
)
def test_columns_at_hand_are_those_of_every_look(
    fired: list[str] | None, needed: tuple[str, ...]
) -> None:
    workflow = Workflow.model_validate({"survey": {"flightlines": "a.laz"}, "output": "out"})
    cell: Any = SimpleNamespace(
        context=SimpleNamespace(workflow=workflow), args={"halo": 1000, "fired": fired}
    )
    assert {*surface_rasters.COLUMNS_NEEDED, *needed} <= {*_columns(cell)}
