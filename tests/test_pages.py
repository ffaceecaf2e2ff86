"""Pages for people are true: their code runs, their commands exist, messages are ours."""

import re
import shlex
from pathlib import Path
from typing import Any

import click
import matplotlib as mpl
import numpy as np
import pytest

from spl_batch.cli import cli
from tests.workflow_files import blocks

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"
GUIDES = ("tutorial.md", "coming_from.md", "using.md", "troubleshooting.md")


def test_the_code_of_the_tutorial_runs(
    tiny_output: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    mpl.use("agg")
    (tmp_path / "survey").mkdir()
    (tmp_path / "survey" / "out").symlink_to(tiny_output)
    monkeypatch.chdir(tmp_path)
    names: dict[str, Any] = {}
    code = blocks(DOCS / "tutorial.md", "python")
    assert len(code) == 4
    for block in code:
        exec(compile(block, "tutorial.md", "exec"), names)  # noqa: S102 - it is our own page
    before, after = (len(axes.collections[0].get_offsets()) for axes in names["figure"].axes)
    assert before > after > 0


def test_the_code_of_the_page_on_arrays_runs(
    tiny_survey: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (line, *_) = sorted(tiny_survey.parent.glob("flightlines/*.laz"))
    (tmp_path / "flightline.laz").symlink_to(line)
    monkeypatch.chdir(tmp_path)
    names: dict[str, Any] = {}
    *first, beams = blocks(DOCS / "arrays.md", "python")
    assert len(first) == 2
    for block in first:
        exec(compile(block, "arrays.md", "exec"), names)  # noqa: S102 - it is our own page
    assert names["labels"].basis == names["noise"].basis == "cloud"
    printed = re.search(r"# (\d\.\d+): 3 000 points", first[-1])
    assert printed
    assert float(np.median(names["noise"].density)) == pytest.approx(float(printed[1]), abs=5e-4)
    exec(compile(beams, "arrays.md", "exec"), names)  # noqa: S102
    found = names["noise"]
    assert found.basis == "intersection"
    assert found.density.shape == found.mean.shape == (20,)
    assert (found.density > 0).all()
    assert found.mean.min() < found.density.min(), "less where a voxel is cut by the gate"


@pytest.mark.parametrize("name", GUIDES)
def test_commands_on_pages_are_commands(name: str) -> None:
    text = (DOCS / name).read_text(encoding="utf-8")
    found = [line for block in blocks(DOCS / name, "sh") for line in block.splitlines()]
    found += re.findall(r"`(spl-batch [a-z][^`]*)`", text)
    for line in found:
        if not line.startswith("spl-batch ") or "|" in line:
            continue
        verb, *arguments = shlex.split(line.split("#")[0])[1:]
        assert verb in cli.commands, line
        options = {
            one for p in cli.commands[verb].params for one in p.opts if isinstance(p, click.Option)
        }
        given = {word.split("=")[0] for word in arguments if word.startswith("--")}
        assert given <= options, line


def test_messages_on_the_page_are_messages_of_the_program() -> None:
    text = (DOCS / "troubleshooting.md").read_text(encoding="utf-8")
    found = re.findall(r"\*\*`([^`]+)`\*\*", text)
    assert len(found) > 10
    source = "".join(
        path.read_text(encoding="utf-8") for path in sorted((ROOT / "spl_batch").rglob("*.py"))
    )
    # Texts that go over a line, and values in them.
    joined = re.sub(r'"\s+f?"', "", source)
    missing = [one for one in found if one not in joined]
    assert missing == []


def test_every_page_is_on_the_site() -> None:
    listed = (ROOT / "mkdocs.yml").read_text(encoding="utf-8")
    pages = [path.relative_to(DOCS).as_posix() for path in DOCS.rglob("*.md")]
    assert [page for page in pages if f": {page}\n" not in listed] == []
