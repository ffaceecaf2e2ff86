"""Speed of the simulator: points per second, kernels compiled, files written.

Run ``python -m benchmarks.airborne.simulate.simulator [SCENE.yaml]``; without a scene the
quickstart's is flown twice, the first time for compilation.
"""

import sys
import tempfile
import time
from pathlib import Path

from spl_batch.airborne.simulate import load_scene, preset_scene, simulate


def main() -> None:
    """Simulate twice and print the second run's speed."""
    scene = load_scene(Path(sys.argv[1])) if len(sys.argv) > 1 else preset_scene("quickstart")
    with tempfile.TemporaryDirectory() as folder:
        first = simulate(scene, Path(folder))
        cpu = time.process_time()
        second = simulate(scene, Path(folder))
        cpu = time.process_time() - cpu
    print(f"scene {scene.name}: {second.points} points")
    for name, count in second.kinds.items():
        print(f"  {name:<12}{count:>10}")
    print(f"first run  {first.wall_s:6.1f} s, with compilation or loading of kernels")
    print(f"second run {second.wall_s:6.1f} s, {second.points / second.wall_s:,.0f} points/s")
    print(f"  processor time {cpu:.1f} s, {second.points / cpu:,.0f} points/s and core")


if __name__ == "__main__":
    main()
