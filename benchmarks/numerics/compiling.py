"""What compiling the kernels takes, by one process and in shares side by side.

    python -m benchmarks.numerics.compiling [SHARES ...]

Compiles all kernels of the airborne chain into an empty folder, by as many processes as given (1
and 2 by default), each its share as workers do before their first task. Prints the kernels that
were compiled, without those that they call, processor time and wall time; then the same for as
many new processes that find the folder as those have left it, each loading all kernels: nothing is
left to compile for them where code is kept on disk, and kept whole by processes that wrote it at
the same time.
"""

import argparse
import multiprocessing
import os
import resource
import tempfile
import time
from collections.abc import Sequence


def compile_one(share: int, shares: int) -> tuple[int, float]:
    """Compile a share: kernels that were compiled, and processor time, children included [s]."""
    # numba looks for the folder when it is imported.
    from spl_batch.airborne import precompile  # noqa: PLC0415

    compiled = precompile.compile_share(share, shares)
    children = resource.getrusage(resource.RUSAGE_CHILDREN)
    return compiled, time.process_time() + children.ru_utime + children.ru_stime


def measure(tasks: Sequence[tuple[int, int]]) -> tuple[int, float, float]:
    """Kernels, processor time and wall time of a process for each share, side by side [s]."""
    start = time.perf_counter()
    context = multiprocessing.get_context("spawn")
    with context.Pool(len(tasks), maxtasksperchild=1) as pool:
        found = pool.starmap(compile_one, tasks, chunksize=1)
    wall_s = time.perf_counter() - start
    return sum(n for n, _ in found), sum(s for _, s in found), wall_s


def main() -> None:
    """Print two lines for each number of processes."""
    print("processes              kernels  processor [s]  wall [s]")
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("shares", nargs="*", type=int, default=[1, 2], help="processes")
    for shares in parser.parse_args().shares:
        with tempfile.TemporaryDirectory() as folder:
            os.environ["NUMBA_CACHE_DIR"] = folder
            rounds = {"": [(k, shares) for k in range(shares)], "again, all": [(0, 1)] * shares}
            for name, tasks in rounds.items():
                functions, processor_s, wall_s = measure(tasks)
                row = f"{functions:11d}{processor_s:15.1f}{wall_s:10.1f}"
                print(f"{shares:9d} {name:10s}{row}", flush=True)


if __name__ == "__main__":
    main()
