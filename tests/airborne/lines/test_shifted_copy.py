"""Copies of clouds with heights that are shifted."""

from pathlib import Path
from typing import Any

import laspy
import numpy as np
import pytest
from numpy.typing import NDArray

from spl_batch.errors import WorkflowError
from spl_batch.formats.las.header import Vlr
from spl_batch.formats.las.writer import KEEP_CLASS, Shifted, write_classified
from tests import surveys

RECORD = Vlr(b"spl-batch", 1, b"shifts", b"{}")


def copy(
    folder: Path, *, z_m: float, up_q: int, point_format: int = 6, scale: float = 0.01
) -> tuple[Any, Any]:
    """A file of two flightlines, the second of which is shifted, and its copy."""
    psid = np.array([1, 2], np.uint16)
    columns = {"x": np.zeros(2), "y": np.zeros(2), "z": np.full(2, z_m), "point_source_id": psid}
    source = surveys.write_cloud(
        folder / "given.laz", columns, point_format=point_format, scale=scale, crs=None
    )

    def shifts(psid: NDArray[np.uint16], time_s: NDArray[np.float64]) -> NDArray[np.int32]:
        assert np.isnan(time_s).all() == (point_format == 2)
        return np.where(psid == 2, up_q, 0).astype(np.int32)

    def labels(start: int, stop: int) -> dict[str, NDArray[Any]]:
        kept = np.full(stop - start, KEEP_CLASS, np.uint8)
        return {"classification": kept, "noise_class": kept}

    target, shifted = folder / "made.laz", Shifted(shifts, RECORD)
    write_classified(source, target, labels=labels, diagnostics=False, crs=None, shifted=shifted)
    return laspy.read(source), laspy.read(target)


@pytest.mark.parametrize("point_format", [2, 6])
def test_shifts_are_rounded_to_the_scale_and_the_file_says_so(
    tmp_path: Path, point_format: int
) -> None:
    given, made = copy(tmp_path, z_m=5.0, up_q=104, point_format=point_format)
    assert (made.X - given.X).tolist() == [0, 0]
    assert (made.Z - given.Z).tolist() == [0, 10]
    assert made.header.maxs[2] == pytest.approx(5.1)
    assert [v.record_id for v in made.header.vlrs if v.user_id == "spl-batch"] == [1]


def test_what_does_not_fit_into_the_file_is_refused(tmp_path: Path) -> None:
    with pytest.raises(WorkflowError, match=r"z of some points does not fit"):
        copy(tmp_path, z_m=2_147_483.0, up_q=1000, scale=0.001)
