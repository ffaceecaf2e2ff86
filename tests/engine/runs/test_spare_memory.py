"""What a worker has freed is given back where its limit is near."""

import os
import subprocess
import sys

from spl_batch.engine.flow.cluster import SETTINGS

IN_PIECES = """
import numpy as np, psutil
from spl_batch.engine.tasks import spare_memory

def resident_mib():
    return psutil.Process().memory_info().rss / 2**20

pieces = [np.ones(100_000, np.uint8) for _ in range(2000)]
kept = pieces[::50]
del pieces
held = resident_mib()
for limit in (None, 100 << 30, 100 << 20):
    spare_memory.limit_memory(limit)
    spare_memory.give_back()
    print(round(held - resident_mib()))
"""


def test_memory_in_pieces_is_given_back_where_the_limit_is_near() -> None:
    prefix = "distributed.nanny.pre-spawn-environ."
    of_worker = {k.removeprefix(prefix): str(v) for k, v in SETTINGS.items() if prefix in k}
    ended = subprocess.run(  # noqa: S603 - the text above
        [sys.executable, "-c", IN_PIECES],
        env=os.environ | of_worker, capture_output=True, text=True, check=True,
    )  # fmt: skip
    none, far, near = map(int, ended.stdout.split())
    assert (none, far) == (0, 0)
    assert near > 120
