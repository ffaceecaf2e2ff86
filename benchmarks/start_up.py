"""How soon a finished run is found finished: ``python -m benchmarks.start_up``.

A small survey is run; then N further receipts and tiles are put into its store, as a large survey
has them, and the run is started again.
"""

import argparse
import tempfile
import time
from pathlib import Path

from spl_batch import api
from spl_batch.airborne.simulate import preset_scene, simulate
from spl_batch.engine.store.working_store import Store, write_receipt
from spl_batch.engine.tasks.task import Receipt


def main() -> None:
    """Print the time of each run."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--receipts", type=int, default=100_000)
    count = parser.parse_args().receipts
    with tempfile.TemporaryDirectory() as folder:
        simulate(preset_scene("tiny"), Path(folder))
        workflow = Path(folder, "workflow.yaml")
        api.run(workflow, workers=0)
        store = Store(Path(folder, "out"))
        for k in range(count):
            name = f"{k}_999"
            store.table("tiles", name).write_bytes(b"")
            receipt = Receipt("build_tile", name, "key", "digest", "", {}, {}, 0, 0.0, 0.0)
            write_receipt(store, receipt)
        for _ in range(2):
            start = time.perf_counter()
            api.run(workflow, workers=0)
            print(f"{count:,} more receipts: {time.perf_counter() - start:.1f} s")


if __name__ == "__main__":
    main()
