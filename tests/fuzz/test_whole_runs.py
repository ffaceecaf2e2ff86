"""A few surveys with mutants among their files; ``python -m tests.fuzz`` runs many."""

from itertools import count
from pathlib import Path
from tempfile import mkdtemp

import pytest
from hypothesis import HealthCheck, Phase, given, reject, settings
from hypothesis import strategies as st

from tests.fuzz.mutants import mutants
from tests.fuzz.whole_runs import KINDS, attempt, kind

FEW = {"flightlines": 8, "old flightlines": 6, "granules": 4}
"""Mutants in the survey; one of what a run has only one of."""


@pytest.mark.slow
@pytest.mark.parametrize("name", KINDS)
def test_a_survey_with_mutants_delivers_what_is_sound(name: str, tmp_path: Path) -> None:
    files, tried = FEW.get(name, 1), count()

    @settings(
        max_examples=1, deadline=None, derandomize=True, database=None,
        phases=[Phase.generate], suppress_health_check=list(HealthCheck),
    )  # fmt: skip
    @given(st.lists(mutants(kind(name).seed), min_size=files, max_size=files))
    def each(contents: list[bytes]) -> None:
        if next(tried) == 0:
            reject()  # Hypothesis begins with the simplest: the first byte is 0 in each of them
        attempt(name, contents, Path(mkdtemp(dir=tmp_path)))

    each()
    assert next(tried) > 1
