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


FILES = 3


def strip(folder: Path) -> Path:
    """Workflow of one pass that is cut into files, an equal piece in each."""
    line = surveys.flightline(shots=FILE_SHOTS * FILES)
    number = np.rint((line["gps_time"] - surveys.START_S) * surveys.PRF_HZ) // FILE_SHOTS
    for k in range(FILES):
        surveys.write_cloud(folder / "lines" / f"part_{k}.laz", surveys.take(line, number == k))
    stop_s = surveys.START_S + FILE_SHOTS * FILES / surveys.PRF_HZ + 1
    surveys.write_trajectory(folder / "trajectory.csv", stop_s=stop_s)
    return surveys.write_workflow(folder)


@pytest.mark.slow
def test_memory_does_not_grow_with_the_tasks_that_a_worker_has_done(tmp_path: Path) -> None:
    result = api.run(
        strip(tmp_path), workers=1, memory=f"{LIMIT_MIB}MiB", overrides=["tiling.block_tiles=1"]
    )
    assert result.exit_status == 0
    store = Store(result.output)
    done = {kind: [r.peak_rss_mb for r in read_receipts(store, kind)] for kind in STEPS}
    assert max(map(max, filter(None, done.values()))) < LIMIT_MIB
    for kind in ("denoise", "ground", "surface"):
        # The highest so far of one worker: in order of size they are in order of time.
        peaks = sorted(done[kind])
        assert len(peaks) >= 3
        assert peaks[-1] < peaks[len(peaks) // 4] + 60, kind
