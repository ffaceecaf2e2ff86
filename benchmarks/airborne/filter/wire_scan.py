"""The scan along lines: pure noise that it keeps, conductors that it finds, its speed.

``python -m benchmarks.airborne.filter.wire_scan [POINTS]`` prints, for uniform noise of 0.02-1 per
m3, the share that is kept at alpha 1e-3 and the default beside alpha; then the share of one
straight-hanging conductor's returns that is found in such noise, by returns per metre (all
flightlines together), and of three side by side; then the seconds per million points.
"""

import sys
import time

import numpy as np
from numpy.typing import NDArray

from spl_batch.airborne.filter.filter_interface import Cloud
from spl_batch.airborne.filter.wires.wire_scan import scan
from spl_batch.airborne.settings import WireSettings

DENSITIES = (0.02, 0.05, 0.13, 0.3, 1.0)
RATES = (0.15, 0.3, 0.6, 0.9, 1.5)


def as_cloud(metres: NDArray[np.float64], density: float) -> Cloud:
    """Points as the scan takes them, all asked for."""
    xyz = np.rint((metres - metres.min(axis=0)) * 1000).astype(np.int32)
    n = len(xyz)
    nothing = np.zeros(n, dtype=np.bool_)
    return Cloud(xyz, (0, 0, 0), np.full(n, density), ~nothing, nothing)


def noise(rng: np.random.Generator, n: int, density: float) -> NDArray[np.float64]:
    """About n uniform points in a box 60 m high."""
    side = (n / density / 60.0) ** 0.5
    size = np.array([side, side, 60.0])
    box: NDArray[np.float64] = rng.uniform(0, 1, (rng.poisson(n), 3)) * size
    return box


def conductors(rng: np.random.Generator, per_m: float, strands: int) -> NDArray[np.float64]:
    """Catenaries over three spans of 60 m, 1 m apart, sag 1.2 m, 5 cm of spread."""
    parts = []
    for k in range(strands):
        x = rng.uniform(0, 180.0, rng.poisson(180.0 * per_m))
        along = x % 60.0 - 30.0
        parts.append(np.stack([x, 0 * x + 30.0 + k, 25.0 + 1.2 * (along / 30.0) ** 2], axis=1))
    wire: NDArray[np.float64] = np.concatenate(parts)
    return wire + rng.normal(0, 0.05, wire.shape)


def kept_noise(n: int) -> None:
    """Share of uniform noise that is kept, by density and alpha."""
    rng = np.random.default_rng(1)
    default = WireSettings().alpha
    print(f"pure noise kept [%]   alpha 0.1 %   alpha {default:.3%}")
    for density in DENSITIES:
        cloud = as_cloud(noise(rng, n, density), density)
        shares = [scan(cloud, WireSettings(alpha=a)).signal.mean() for a in (1e-3, default)]
        print(f"{density:12.2f} /m3     {shares[0]:10.4%}   {shares[1]:10.4%}")


def found_wires() -> None:
    """Share of a conductor's returns that is kept, by its density and the noise's."""
    rng = np.random.default_rng(2)
    print("conductor kept [%] at returns/m:  " + "  ".join(f"{rate:6.2f}" for rate in RATES))
    for strands in (1, 3):
        for density in DENSITIES[:4]:
            shares = []
            for rate in RATES:
                wire = conductors(rng, rate, strands)
                box = noise(rng, int(density * 60**2 * 180), density)
                box *= np.array([180.0, 60.0, 60.0]) / np.maximum(box.max(axis=0), 1e-9)
                found = scan(as_cloud(np.concatenate([wire, box]), density), WireSettings())
                shares.append(found.signal[: len(wire)].mean())
            text = "  ".join(f"{100 * share:6.1f}" for share in shares)
            print(f"  {strands} abreast, {density:5.2f} noise/m3:     {text}")


def speed(n: int) -> None:
    """Processor seconds per million points, two in five of which are noise."""
    rng = np.random.default_rng(3)
    points = noise(rng, int(0.4 * n), 0.13)
    side = points[:, :2].max()
    ground = rng.uniform(0, 1, (int(0.6 * n), 3)) * [side, side, 0.1] - [0, 0, 5.0]
    cloud = as_cloud(np.concatenate([points, ground]), 0.13)
    scan(cloud, WireSettings())
    start = time.process_time()
    scan(cloud, WireSettings())
    print(f"{(time.process_time() - start) / len(cloud.xyz) * 1e6:.2f} s per million points")


def main(points: int) -> None:
    """Print everything."""
    kept_noise(points)
    found_wires()
    speed(2 * points)


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 300_000)
