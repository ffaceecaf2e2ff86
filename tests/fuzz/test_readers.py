"""Mutants through every reader; ``MUTANTS=1000`` in the environment makes a long round of it."""

import os
from pathlib import Path
from tempfile import TemporaryDirectory

import pytest
from hypothesis import HealthCheck, given, settings

from tests.fuzz.mutants import mutants
from tests.fuzz.readers import attempt
from tests.fuzz.seeds import SEEDS, seed

SHORT = settings(
    max_examples=int(os.environ.get("MUTANTS", "30")),
    deadline=None,
    derandomize=True,
    database=None,
    suppress_health_check=[HealthCheck.too_slow, HealthCheck.data_too_large],
)


@pytest.mark.parametrize("name", SEEDS)
def test_a_sound_file_is_read(name: str, tmp_path: Path) -> None:
    assert attempt(name, seed(name).content, tmp_path)


@pytest.mark.parametrize("name", SEEDS)
def test_a_mutant_is_read_or_refused_in_one_line(name: str) -> None:
    with TemporaryDirectory() as folder:

        @SHORT
        @given(mutants(seed(name)))
        def each(content: bytes) -> None:
            attempt(name, content, Path(folder))

        each()
