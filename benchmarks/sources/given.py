"""What the groups of the page are given, and what they give back."""

from collections.abc import Iterable
from pathlib import Path
from typing import NamedTuple, TypeVar

from benchmarks.sources.twins import TWINS
from spl_batch.airborne.simulate import simulate

Row = TypeVar("Row")

Figures = dict[str, float]
"""Measured values by key."""

QUICK_SHARE = 0.3
"""Part of a twin's edges that is flown with ``--quick``."""


class Given(NamedTuple):
    """Folder for surveys, and whether small twins do."""

    folder: Path
    quick: bool = False
    seed: int = 1

    def some(self, rows: Iterable[Row], count: int = 1) -> tuple[Row, ...]:
        """All of some rows, or the first of them where small twins do."""
        return tuple(rows)[: count if self.quick else None]

    def survey(self, name: str) -> Path:
        """Folder of a twin, simulated unless it is there."""
        folder = self.folder / f"{name.replace(' ', '_')}_{self.seed}"
        if not (folder / "workflow.yaml").exists():
            twin = TWINS[name]
            simulate(twin(self.seed, QUICK_SHARE) if self.quick else twin(self.seed), folder)
        return folder
