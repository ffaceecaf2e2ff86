"""The warning of terrain that is not known well, from what ground cells have counted."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from spl_batch.airborne.report.coverage import sparse_vegetation, unsure_terrain
from spl_batch.airborne.report.model import Density
from spl_batch.airborne.settings import ClassSettings
from spl_batch.airborne.settings.workflow import Workflow
from spl_batch.airborne.tasks.cells.pulses import covered
from spl_batch.constants import NODATA


def done(*cells: tuple[int, int]) -> Any:
    """Receipts of ground cells: heights, and how many of them are not known well."""
    facts = [{"heights": heights, "unsure": unsure} for heights, unsure in cells]
    return {"surface": {str(k): SimpleNamespace(facts=f) for k, f in enumerate(facts)}}


def test_much_terrain_far_from_ground_is_told_with_its_share() -> None:
    (text,) = unsure_terrain(done((1000, 100), (3000, 20)))
    assert text.startswith("3.0% of the terrain")
    assert "dtm_quality.tif" in text


def test_little_of_it_none_or_a_run_that_did_not_count_says_nothing() -> None:
    assert unsure_terrain(done((1000, 5), (3000, 20))) == ()
    assert unsure_terrain(done((0, 0))) == ()
    assert unsure_terrain({}) == ()
    earlier: Any = {"surface": {"a": SimpleNamespace(facts={"voids": 3})}}
    assert unsure_terrain(earlier) == ()


@pytest.mark.parametrize(("per_m2", "told"), [(0.24, 1), (0.99, 1), (1.0, 0), (None, 0)])
def test_low_vegetation_of_few_returns_is_told(per_m2: float | None, told: int) -> None:
    asked = ClassSettings.model_validate({"vegetation": {}})
    said = sparse_vegetation(Density(mean_per_m2=per_m2), asked)
    assert len(said) == told
    assert all("too few for classes 3 and 4" in text for text in said)
    assert sparse_vegetation(Density(mean_per_m2=per_m2), ClassSettings()) == ()


def test_a_ground_cell_counts_heights_and_those_that_may_be_off() -> None:
    dtm = np.full((4, 4), 7.0, np.float32)
    dtm[0] = NODATA
    sigma = np.where(dtm == NODATA, np.float32(NODATA), np.float32(0.1))
    sigma[2, 1:3] = 0.7
    arrays = {"dtm": dtm, "dtm_quality": sigma, "density": np.ones((4, 4), np.float32)}
    context: Any = SimpleNamespace(workflow=Workflow.model_construct())
    found: dict[str, Any] = covered(np.ones((16, 16), np.bool_), arrays, context)
    assert (found["heights"], found["unsure"]) == (12, 2)
