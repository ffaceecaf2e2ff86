"""Workers stay under their limit however long the survey is."""

from pathlib import Path

import numpy as np
import pytest

from spl_batch import api
from spl_batch.airborne.steps import STEPS
from spl_batch.engine.store.working_store import Store, read_receipts
from tests import surveys

LIMIT_MIB = 900
FILE_SHOTS = 2000
"""Shots of a file: about 52 000 points."""


def strip(folder: Path, files: int) -> Path:
    """Workflow of one pass that is cut into so many files, an equal piece in each."""
    line = surveys.flightline(shots=FILE_SHOTS * files)
    number = np.rint((line["gps_time"] - surveys.START_S) * surveys.PRF_HZ) // FILE_SHOTS
    for k in range(files):
        surveys.write_cloud(folder / "lines" / f"part_{k}.laz", surveys.take(line, number == k))
    stop_s = surveys.START_S + FILE_SHOTS * files / surveys.PRF_HZ + 1
    surveys.write_trajectory(folder / "trajectory.csv", stop_s=stop_s)
    return surveys.write_workflow(folder)


@pytest.mark.slow
def test_memory_does_not_grow_with_the_survey(tmp_path: Path) -> None:
    peaks, tasks = [], []
    for files in (1, 4):
        workflow = strip(tmp_path / str(files), files)
        result = api.run(
            workflow, workers=1, memory=f"{LIMIT_MIB}MiB", overrides=["tiling.block_tiles=1"]
        )
        assert result.exit_status == 0
        store = Store(result.output)
        done = [r for kind in STEPS for r in read_receipts(store, kind)]
        assert {"denoise", "ground", "surface", "deliver_file"} <= {r.kind for r in done}
        peaks.append(max(r.peak_rss_mb for r in done))
        tasks.append(sum(r.kind in {"denoise", "ground"} for r in done))
    assert tasks[1] >= 2 * tasks[0] > 0, "a longer survey has more tasks, not larger ones"
    assert max(peaks) < LIMIT_MIB
    assert peaks[1] < peaks[0] + 60
