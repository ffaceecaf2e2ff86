"""A few surveys with mutants among their files; ``python -m tests.fuzz`` runs many."""

from pathlib import Path
from tempfile import mkdtemp

import pytest
from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import strategies as st

from tests.fuzz.mutants import mutants
from tests.fuzz.whole_runs import KINDS, attempt, kind

FEW = {"flightlines": (2, 6), "old flightlines": (1, 6), "granules": (2, 4)}
"""Surveys, and mutants in each; one survey with one mutant of what a run has only one of."""


@pytest.mark.slow
@pytest.mark.parametrize("name", KINDS)
def test_a_survey_with_mutants_delivers_what_is_sound(name: str, tmp_path: Path) -> None:
    examples, files = FEW.get(name, (2, 1))

    @settings(
        max_examples=examples, deadline=None, derandomize=True, database=None,
        phases=[Phase.generate], suppress_health_check=list(HealthCheck),
    )  # fmt: skip
    @given(st.lists(mutants(kind(name).seed), min_size=files, max_size=files))
    def each(contents: list[bytes]) -> None:
        attempt(name, contents, Path(mkdtemp(dir=tmp_path)))

    each()
