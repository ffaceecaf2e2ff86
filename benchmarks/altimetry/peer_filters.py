"""Published filters of photons beside ours, by scikit-learn (extra ``peers``).

* ``dbscan``: M. Ester et al., KDD 1996, on an axis along the track that is a tenth as long.
* ``knn_otsu``: mean distance to neighbours, split where Otsu's criterion is largest (N. Otsu, IEEE
  Trans. SMC 9, 1979).
* ``yapc``: J. Lee's *Yet Another Photon Classifier* of ATL03 (T. Sutterley and A. Gibbons,
  ``yapc``): K photons nearest in height within a window lend each their share of it.
* ``histogram``: boxes that hold more than their column's mean and three standard deviations, as the
  signal finding of ATL03 begins (T. Neumann et al., Remote Sens. Environ. 233, 2019).

None of them is scaled by noise, and each knows one beam at a time: they are for comparison.
"""

from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Final

import numpy as np
from numpy.typing import NDArray

from spl_batch.errors import WorkflowError

EXTRA: Final = "peers"
"""Optional extra that brings scikit-learn."""

DBSCAN_M: Final = (10.0, 1.0)
"""Semi-axes of a neighbourhood along the track and in height [m]."""

DBSCAN_PHOTONS: Final = 4
"""Photons of a core's neighbourhood, itself included; twice the dimensions [count]."""

KNN: Final = 15
KNN_ASPECT: Final = 10.0

YAPC_WINDOW_M: Final = (15.0, 6.0)
"""Length and height of the window [m], as published."""

YAPC_STRETCH_M: Final = 140.0
"""A major frame: 200 shots, over which K and weights are taken [m]."""

YAPC_LEAST: Final = 5
"""Least K [count], as published."""

YAPC_WEIGHT: Final = 80
"""Least weight of signal, of 255."""

BOX_M: Final = (50.0, 2.0)
"""Length and height of a box of the histogram [m]."""

BOX_SD: Final = 3.0
"""Standard deviations above its column's mean that a box of signal holds."""

_Filter = Callable[[NDArray[np.float64], NDArray[np.float64]], NDArray[np.bool_]]


def keep(
    name: str, along_m: NDArray[np.float64], height_m: NDArray[np.float64]
) -> NDArray[np.bool_]:
    """Photons that a published filter takes, (n,) bool.

    Parameters
    ----------
    name : str
        One of :data:`PEERS`.
    along_m, height_m : (n,) float64
        Photons of a beam, in any order [m].

    Raises
    ------
    WorkflowError
        If scikit-learn is not installed.
    """
    require(name)
    if not len(along_m):
        return np.zeros(0, np.bool_)
    return PEERS[name](along_m, height_m)


def require(name: str) -> None:
    """Refuse a published filter whose library is missing.

    Raises
    ------
    WorkflowError
        If scikit-learn is not installed.
    """
    try:
        import sklearn  # noqa: F401, PLC0415
    except ImportError as error:
        raise WorkflowError(
            f"method {name} needs scikit-learn; install it with: pip install 'spl-batch[{EXTRA}]'"
        ) from error


def dbscan(along_m: NDArray[np.float64], height_m: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Photons of any cluster, (n,) bool."""
    from sklearn.cluster import DBSCAN  # noqa: PLC0415

    plane = np.stack([along_m, height_m], axis=1) / DBSCAN_M
    found: NDArray[np.bool_] = DBSCAN(eps=1.0, min_samples=DBSCAN_PHOTONS).fit(plane).labels_ >= 0
    return found


def knn_otsu(along_m: NDArray[np.float64], height_m: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Photons whose neighbours are near by Otsu's threshold of the logarithm, (n,) bool."""
    from skimage.filters import threshold_otsu  # noqa: PLC0415
    from sklearn.neighbors import NearestNeighbors  # noqa: PLC0415

    plane = np.stack([along_m / KNN_ASPECT, height_m], axis=1)
    count = min(KNN + 1, len(plane))
    distance, _ = NearestNeighbors(n_neighbors=count).fit(plane).kneighbors(plane)
    # The first neighbour is the photon itself; photons are a millimetre apart at least.
    mean = np.log(distance[:, 1:].mean(axis=1) + 1e-3) if count > 1 else np.zeros(len(plane))
    found: NDArray[np.bool_] = mean < threshold_otsu(mean)  # type: ignore[no-untyped-call]
    return found


def yapc(along_m: NDArray[np.float64], height_m: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Photons of a weight of 80 of 255 or more, (n,) bool."""
    from sklearn.neighbors import NearestNeighbors  # noqa: PLC0415

    half = np.array(YAPC_WINDOW_M) / 2.0
    plane = np.stack([along_m, height_m], axis=1)
    search = NearestNeighbors(radius=1.0, metric="chebyshev").fit(plane / half)
    frame = np.floor(along_m / YAPC_STRETCH_M).astype(np.int64)
    order = np.argsort(frame, kind="stable")
    edges = np.flatnonzero(np.diff(frame[order], prepend=frame[order[0]] - 1))
    weight = np.zeros(len(plane))
    for rows in np.split(order, edges[1:]):
        k = max(YAPC_LEAST, int(np.sqrt(len(rows)) / 2.0))
        near = search.radius_neighbors(plane[rows] / half, return_distance=False)
        for row, others in zip(rows, near, strict=True):
            if len(others) > k:
                off = np.sort(np.abs(height_m[others] - height_m[row]))[1 : k + 1]
                weight[row] = np.sum(half[1] - off) / (k * half[1])
    found: NDArray[np.bool_] = weight * 255.0 >= YAPC_WEIGHT
    return found


def histogram(along_m: NDArray[np.float64], height_m: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Photons of boxes that stick out of their column, (n,) bool."""
    column, box = (
        np.floor(v / m).astype(np.int64) for v, m in zip((along_m, height_m), BOX_M, strict=True)
    )
    base, width = box.min(), int(np.ptp(box)) + 1
    columns, at = np.unique(column, return_inverse=True)
    flat = at * width + box - base
    count = np.bincount(flat, minlength=len(columns) * width).reshape(-1, width)
    limit = count.mean(axis=1) + BOX_SD * count.std(axis=1)
    found: NDArray[np.bool_] = count.ravel()[flat] > limit[at]
    return found


PEERS: Final[Mapping[str, _Filter]] = MappingProxyType(
    {"dbscan": dbscan, "knn_otsu": knn_otsu, "yapc": yapc, "histogram": histogram}
)
"""Filters by name."""
