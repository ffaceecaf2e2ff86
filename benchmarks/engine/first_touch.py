"""What memory costs that a process touches for the first time.

    python -m benchmarks.engine.first_touch [--gib 2] [--rest-s 10]

Prints seconds per GiB that a process writes a byte into each page of, the first time and the
second, alone and beside another that does the same. Before each it rests, so that what was freed
goes back to whom it belongs: a virtual machine gives free memory back to its host, and fetches it
again page by page. A worker pays for its highest memory once; two workers pay at the same time.
"""

import argparse
import mmap
import multiprocessing
import time

import numpy as np

PAGE = 4096
LARGE_PAGES = 14
"""Advice that memory may lie in large pages, as workers give it (MADV_HUGEPAGE)."""


def touch(gib: float) -> tuple[float, float]:
    """Seconds per GiB of the first and of the second time."""
    size = int(gib * 2**30)
    with mmap.mmap(-1, size, flags=mmap.MAP_PRIVATE | mmap.MAP_ANONYMOUS) as held:
        held.madvise(LARGE_PAGES)
        pages = np.frombuffer(held, np.uint8)[::PAGE]
        taken = []
        for value in (1, 2):
            start = time.perf_counter()
            pages[:] = value
            taken.append((time.perf_counter() - start) / gib)
        del pages
    return taken[0], taken[1]


def main() -> None:
    """Read the arguments."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--gib", type=float, default=2.0)
    parser.add_argument("--rest-s", type=float, default=10.0)
    given = parser.parse_args()
    print(f"{'s / GiB':12s}{'first':>8s}{'second':>8s}")
    for processes in (1, 2, 1, 2):
        time.sleep(given.rest_s)
        with multiprocessing.get_context("spawn").Pool(processes) as pool:
            first, second = np.array(pool.map(touch, [given.gib] * processes, chunksize=1)).T
        print(f"{processes} at once   {first.mean():8.2f}{second.mean():8.2f}", flush=True)


if __name__ == "__main__":
    main()
