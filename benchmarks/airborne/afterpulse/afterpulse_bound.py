r"""What the best possible filter knows of a follower: whether it is an afterpulse.

For :mod:`benchmarks.airborne.afterpulse.afterpulses`. The simulation's own laws are taken as known:
every crown, gap
and reflectance, the gain of every channel, the background, and the law of afterpulses. Unknown
are what a receiver does not record: where within its footprint a beamlet's light went, and which
return started which. Both are summed over by Bayes' rule, from *all* returns of the beamlet and
its silence elsewhere:

.. math:: P \propto \sum_w e^{-\int \Lambda_w} \sum_S \prod_i \Lambda_w(r_i)\;\text{or}\;
          p f(r_i - r_j) \prod_{j\,\text{unused}} (1 - p F_j)

over paths w and sources S, each return being true or the afterpulse of an earlier one, which
starts at most one. The integral leaves out dead times, :math:`F_j` is the part of the law that
falls on live time. Other beamlets add nothing to it, as paths and photo-electrons of beamlets are
independent once the scene is known; nor do the photo-electrons that merge into a detection, as
what falls into a dead time does so behind either kind. So by Neyman and Pearson's lemma no filter
that sees returns only removes more at the same loss.
"""

import math
from typing import Final, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from spl_batch.airborne.beams.shot_runs import run_starts
from spl_batch.airborne.simulate.beamlet_room import empty_layers
from spl_batch.airborne.simulate.brightness import make_optics
from spl_batch.airborne.simulate.detector import Receiver
from spl_batch.airborne.simulate.scene.beam_layers import look
from spl_batch.airborne.simulate.scene.layout import lay_out
from spl_batch.airborne.simulate.scene.ray_trace import SceneArrays
from spl_batch.airborne.simulate.scene.scene_file import Scene
from spl_batch.airborne.simulate.shots import Optics
from spl_batch.lattice.tables import BeamTable

PATHS: Final = 21
"""Paths of the light within a footprint that are summed over [count]; with 15, 31 and 61 the bound
of a canopy of clumps is the same within 0.2 points."""

CLUSTER_MAX: Final = 9
"""Longest chain of returns whose sources are all tried; in longer ones each counts for itself."""

SLACK_M: Final = 0.003
"""Coordinates are whole millimetres: a lag may be this much below the dead time [m]."""

EDGE_M: Final = 1e-6
"""Least true rate, so that a return that no path explains has a probability [1/m]."""

_ROOT2, _ROOT2PI = math.sqrt(2.0), math.sqrt(2.0 * math.pi)


class Best(NamedTuple):
    """What the simulation's own laws say of each return.

    Parameters
    ----------
    chance : (n,) float64
        Probability that it is an afterpulse; 0 where nothing of the beamlet is in front.
    true_per_m : (n,) float64
        True returns of a channel of gain 1 at its place, the mean over the footprint [1/m]; 0
        likewise. All that depends on the beamlet is left out: its gain, its other returns, its
        silence, which return started which.
    """

    chance: NDArray[np.float64]
    true_per_m: NDArray[np.float64]


def echo_chance(
    scene: Scene,
    time: NDArray[np.float64],
    channel: NDArray[np.uint8],
    beams: BeamTable,
    noise_per_m: float,
    receiver: Receiver,
) -> Best:
    """Probability that each return is an afterpulse, by the simulation's own laws.

    Parameters
    ----------
    scene : Scene
        What was simulated.
    time, channel : (n,) array
        Returns of a flightline by time, channel and range.
    beams : BeamTable
        Their beams.
    noise_per_m : float
        Background of a channel [1/m].
    receiver : Receiver
        The law of afterpulses.
    """
    arrays, optics = lay_out(scene).arrays, make_optics(scene)
    best = Best(np.zeros(len(time)), np.zeros(len(time)))
    _each_beamlet(
        arrays, empty_layers(arrays), beams.origin_m - np.array([*scene.origin_m[:2], 0.0]),
        np.ascontiguousarray(beams.direction), np.ascontiguousarray(beams.range_m),
        run_starts(time, channel), optics.gain[channel.astype(np.int64) - 1], optics, receiver,
        noise_per_m, footprint(PATHS), best.chance, best.true_per_m,
    )  # fmt: skip
    return best


def footprint(count: int) -> NDArray[np.float64]:
    """Places of equal weight under a Gaussian of unit spread: (count, 2) float64."""
    k = np.arange(count)
    radius = np.sqrt(-2.0 * np.log(1.0 - (k + 0.5) / count))
    turn = k * math.pi * (3.0 - math.sqrt(5.0))
    return np.stack([radius * np.cos(turn), radius * np.sin(turn)], axis=1)


@njit(nogil=True, cache=True)
def _each_beamlet(
    arrays: SceneArrays, layers: NDArray[np.float64], origin: NDArray[np.float64],
    direction: NDArray[np.float64], range_m: NDArray[np.float64], starts: NDArray[np.int64],
    gain: NDArray[np.float64], optics: Optics, receiver: Receiver, noise_per_m: float,
    places: NDArray[np.float64], out: NDArray[np.float64], true_per_m: NDArray[np.float64],
) -> None:  # fmt: skip
    path = np.empty(3)
    for b in range(len(starts) - 1):
        low, high = starts[b], starts[b + 1]
        n = high - low
        if n < 2:
            continue
        at = range_m[low:high]
        echo = np.zeros((len(places), n))
        weight = np.empty(len(places))
        axis = direction[low]
        due, spent = _due(at, receiver)
        real = np.empty(n)
        for k in range(len(places)):
            x = axis[0] + optics.sigma_rad * places[k, 0]
            y = axis[1] + optics.sigma_rad * places[k, 1]
            scale = 1.0 / math.sqrt(x * x + y * y + axis[2] * axis[2])
            path[0], path[1], path[2] = x * scale, y * scale, axis[2] * scale
            met = look(arrays, origin[low], path, axis, optics.sigma_rad, layers)
            alive = _signal(met, layers, gain[low], optics, at, receiver.dead_m, real)
            for i in range(n):
                real[i] += noise_per_m * gain[low] + EDGE_M
                true_per_m[low + i] += real[i] / (gain[low] * len(places))
            weight[k] = _sources(at, due, spent, real, receiver, echo[k]) - alive
        weight = np.exp(weight - weight.max())
        weight /= weight.sum()
        for i in range(n):
            out[low + i] = (weight * echo[:, i]).sum()


@njit(nogil=True, cache=True)
def _due(
    at: NDArray[np.float64], receiver: Receiver
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Afterpulses per metre of j at i: (n, n) [1/m]; those of j in live time: (n,) [count]."""
    n = len(at)
    due, spent = np.zeros((n, n)), np.zeros(n)
    window = receiver.afterpulse_max_m - receiver.dead_m
    scale = receiver.afterpulse_scale_m
    whole = -math.expm1(-window / scale)
    p = receiver.afterpulse_probability
    for j in range(n):
        spent[j] = p
        for i in range(j + 1, n):
            lag = at[i] - at[j] - receiver.dead_m
            if -SLACK_M <= lag <= window + SLACK_M:
                due[i, j] = p * math.exp(-max(lag, 0.0) / scale) / (scale * whole)
            start, stop = min(max(lag, 0.0), window), min(lag + receiver.dead_m, window)
            if stop > start:
                spent[j] -= p * (math.exp(-start / scale) - math.exp(-stop / scale)) / whole
    return due, spent


@njit(nogil=True, cache=True)
def _signal(
    met: tuple[int, float, float, float, float], layers: NDArray[np.float64], gain: float,
    optics: Optics, at: NDArray[np.float64], dead_m: float, real: NDArray[np.float64],
) -> float:  # fmt: skip
    """Photo-electrons per metre at each return, filled; those expected in live time [count].

    Beer-Lambert densities of layers and the hard surface, spread by the ranging; the spread does
    not matter to sums.
    """
    count, hard, cosine, rho, _ = met
    full = optics.signal_m2 * gain / hard**2 * math.exp(-2 * optics.extinction_per_m * hard)
    spread = optics.range_sigma_m
    real[:] = 0.0
    left, alive = 1.0, 0.0
    for k in range(count + 1):
        last = k == count
        near, far = (hard, hard) if last else (layers[k, 0], min(layers[k, 1], hard))
        share = 1.0 if last else layers[k, 2]
        bright = full * left * (rho * cosine if last else layers[k, 3])
        thick = far > near and 0.0 < share < 1.0
        per_m = -math.log(1.0 - share) / (layers[k, 1] - near) if thick else 0.0
        alive += bright * (-math.expm1(-per_m * (far - near)) if thick else share)
        for i in range(len(at)):
            behind = at[i] + dead_m
            if thick:
                depth = min(max(at[i] - near, 0.0), far - near)
                edge = 0.5 * (
                    math.erf((at[i] - near) / (_ROOT2 * spread))
                    - math.erf((at[i] - far) / (_ROOT2 * spread))
                )
                rate = bright * per_m * math.exp(-per_m * depth) * edge
                deep = min(max(behind - near, 0.0), far - near)
                alive -= bright * (math.exp(-per_m * depth) - math.exp(-per_m * deep))
            else:
                z = (at[i] - near) / spread
                rate = bright * share * math.exp(-0.5 * z * z) / (_ROOT2PI * spread)
                past = 0.5 * math.erf((behind - near) / (_ROOT2 * spread))
                past -= 0.5 * math.erf((at[i] - near) / (_ROOT2 * spread))
                alive -= bright * share * past
            real[i] += rate
        left *= 1.0 - share
    return alive


@njit(nogil=True, cache=True)
def _sources(
    at: NDArray[np.float64], due: NDArray[np.float64], spent: NDArray[np.float64],
    real: NDArray[np.float64], receiver: Receiver, echo: NDArray[np.float64],
) -> float:  # fmt: skip
    """Sum over the sources of a beamlet's returns, cluster by cluster; its logarithm.

    ``echo`` (n,) is filled with the probabilities, given the path.
    """
    n, low, total = len(at), 0, 0.0
    while low < n:
        high = low + 1
        while high < n and at[high] - at[high - 1] <= receiver.afterpulse_max_m + SLACK_M:
            high += 1
        if high - low > CLUSTER_MAX:
            for i in range(low, high):
                late = due[i, low:i].sum()
                echo[i] = late / (late + real[i])
                total += math.log(late + real[i])
        else:
            total += _cluster(low, high, due, spent, real, echo)
        low = high
    return total


@njit(nogil=True, cache=True)
def _cluster(  # noqa: C901
    low: int, high: int, due: NDArray[np.float64], spent: NDArray[np.float64],
    real: NDArray[np.float64], echo: NDArray[np.float64],
) -> float:  # fmt: skip
    """Every way in which the returns low..high can have started each other.

    ``source[i]`` is low - 1 for a true return, else the return that started it; the ways are
    tried depth first.
    """
    source = np.full(high, low - 2, dtype=np.int64)
    used = np.zeros(high, dtype=np.bool_)
    weight = np.ones(high + 1)
    total, i = 0.0, low
    while i >= low:
        if i == high:
            whole = weight[i]
            for j in range(low, high):
                whole *= 1.0 if used[j] else 1.0 - spent[j]
            total += whole
            for k in range(low, high):
                if source[k] >= low:
                    echo[k] += whole
            i -= 1
            continue
        if source[i] >= low:
            used[source[i]] = False
        j = source[i] + 1
        while j >= low and j < i and (used[j] or due[i, j] == 0.0):
            j += 1
        if j >= i and j >= low:
            source[i] = low - 2
            i -= 1
            continue
        source[i] = j
        if j >= low:
            used[j] = True
        weight[i + 1] = weight[i] * (due[i, j] if j >= low else real[i])
        i += 1
    for k in range(low, high):
        echo[k] /= total
    return math.log(total)
