"""Folders and modules small enough to be looked through; `lint-imports` checks what they import."""

from collections import Counter
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
MAX_MODULES = 15
MAX_LINES = 400


@pytest.mark.parametrize("tree", ["spl_batch", "tests", "benchmarks"])
def test_no_folder_is_crowded(tree: str) -> None:
    files = (path for path in (ROOT / tree).rglob("*.py") if path.name != "__init__.py")
    count = Counter(path.parent for path in files)
    assert [folder for folder, n in count.items() if n > MAX_MODULES] == []


def test_modules_are_short_and_have_a_purpose() -> None:
    files = sorted((ROOT / "spl_batch").rglob("*.py"))
    assert len(files) > 100
    assert [f for f in files if len(f.read_text(encoding="utf-8").splitlines()) >= MAX_LINES] == []
    assert [f for f in files if f.stem in {"utils", "util", "helpers", "misc", "common"}] == []
