"""What receipts say of flightlines against each other, added up by hand."""

import math

import pytest

from spl_batch.airborne.report.good_enough import _swaths
from spl_batch.airborne.report.model import StripPair


def pair(first: str, second: str, patches: int, rmsd: float | None) -> StripPair:
    return StripPair(
        first=first, second=second, patches=patches, area_m2=1.0, centre_m=(0.0, 0.0), up_m=0.0,
        up_sd_m=0.01, flat_patches=patches, rmsd_z_m=rmsd, noise_m=0.02,
    )  # fmt: skip


def test_pairs_count_by_their_places() -> None:
    found = _swaths([pair("1", "2", 10, 0.03), pair("2", "3", 30, 0.05), pair("1", "3", 0, None)])
    assert found is not None
    squares = 10 * 0.03**2 + 30 * 0.05**2
    assert found.rmsd_m == pytest.approx(math.sqrt(squares / 40))
    assert (found.worst_m, found.where) == (0.05, "2 and 3")
    assert (found.pairs, found.places) == (2, 40)
    assert _swaths([pair("1", "3", 0, None)]) is None
