"""Without a trajectory: labels do not depend on tiles, and the report says how beams were found."""

import json
from pathlib import Path

import numpy as np
import pytest

from tests.surveys import assert_same_labels, copy_of, labels, run, small_survey


@pytest.mark.slow
def test_labels_are_the_same_for_two_sizes_of_tiles(tmp_path: Path) -> None:
    first = small_survey(tmp_path / "a")
    second = copy_of(first, tmp_path / "b")
    run(first, "tiling.tile_m=50")
    run(second, "tiling.tile_m=200")
    found = labels(tmp_path / "a" / "out")
    assert_same_labels(found, labels(tmp_path / "b" / "out"))
    classes = np.concatenate([columns["classification"] for columns in found.values()])
    assert len(np.unique(classes)) > 1
    report = json.loads((tmp_path / "a" / "out" / "report.json").read_text(encoding="utf-8"))
    text = json.dumps(report)
    assert '"beam_basis": "trajectory"' not in text
    assert any(f'"beam_basis": "{k}"' in text for k in ("intersection", "scan_angle", "vertical"))
