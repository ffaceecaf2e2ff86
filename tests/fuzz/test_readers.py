"""Mutants through every reader; ``MUTANTS=1000`` in the environment makes a long round of it."""

import os
from pathlib import Path
from tempfile import TemporaryDirectory

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from spl_batch.errors import InputError
from tests.fuzz.mutants import Seed, mutants
from tests.fuzz.readers import BrokenPromiseError, attempt, little_memory
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


@given(st.data())
@SHORT
def test_mutants_are_like_the_sound_file(data: st.DataObject) -> None:
    """Of at most five edits most bytes are left, and hardly one is the file itself."""
    sound = Seed(bytes(range(256)) * 40, ".bin", [(0, 64)])
    mutant = data.draw(mutants(sound))
    assert len(mutant) <= len(sound.content) + 5 * 8 * 400


def test_what_breaks_a_promise_is_found(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def says(error: Exception) -> None:
        def reads(_: Path) -> int:
            raise error

        monkeypatch.setitem(attempt.__globals__["READERS"], "geojson", reads)

    says(InputError("a.las", "is damaged"))
    assert not attempt("geojson", b"{}", tmp_path)
    says(OverflowError("int too big"))
    with pytest.raises(OverflowError):
        attempt("geojson", b"{}", tmp_path)
    silent = InputError("a.las", "")
    silent.args = ("two\nlines",)
    says(silent)
    with pytest.raises(BrokenPromiseError, match="no clear line"):
        attempt("geojson", b"{}", tmp_path)
    with pytest.raises(BrokenPromiseError, match=r"took [67]"), little_memory():
        assert bytearray(b"x") * (700 << 20)
