"""How Zarr's thread ends with the process."""

import subprocess
import sys

import pytest

BUSY = """
import time
from zarr.core import sync
from spl_batch.formats.verified.zarr_chunks import describe
from spl_batch.formats.verified.zarr_loop import stop_loop

def made():
    return describe(shape=[2], chunks=[2], dtype="f4", fill_value=0, attributes={})

first = made()
stop_loop()
assert made() == first
sync.loop[0].call_soon_threadsafe(time.sleep, 0.8)
"""


@pytest.mark.slow
def test_a_process_ends_without_a_word_where_zarr_has_no_processor() -> None:
    """The thread sleeps for longer than Zarr waits for it."""
    ended = subprocess.run(  # noqa: S603 - what stands here
        [sys.executable, "-c", BUSY], capture_output=True, text=True, check=False
    )
    assert (ended.returncode, ended.stderr) == (0, "")
