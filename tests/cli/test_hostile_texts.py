"""Names and texts that others wrote: a terminal, a browser and a log only show them."""

import io
import os
import re
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from rich.table import Table

from spl_batch.cli.console import PlainConsole
from spl_batch.errors import FAULT_MAX, InputError, StoreError, one_line, plain, shortened
from tests import surveys
from tests.io_files import with_record

HOSTILE = (
    "<script>alert(1)<\\&amp;\"'$\\frac{$_^{{7*7}}{%raw%}[bold red]rich[-].laz",
    "esc\x1b[31mred\x1b]0;title\x07line\nend\rturned\u202eround-c1\x9b31m.laz",
    "x" * 240 + ".laz",
)
"""Names of files, which a file system takes."""

OBEYED = re.compile("[\x00-\x09\x0b-\x1f\x7f-\x9f\u202a-\u202e\u2066-\u2069\ud800-\udfff]")
"""What a terminal obeys, but line ends."""


@given(st.text(st.characters()))
def test_plain_text_is_only_shown(text: str) -> None:
    shown = plain(text)
    assert not OBEYED.search(shown)
    assert "\n" not in shown
    assert plain(shown) == shown
    if text.isprintable():
        assert shown == text


def test_what_cannot_be_seen_is_written_out() -> None:
    assert plain("a\x1b[31m\u202eb\n") == "a\\x1b[31m\\u202eb\\n"
    assert plain(os.fsdecode(b"bad\xff.laz")) == "bad\\xff.laz"
    assert plain("5\u00a0km, 5\u202f%") == "5\u00a0km, 5\u202f%", "spaces of any width stay"


def test_a_console_obeys_nothing() -> None:
    shown = io.StringIO()
    console = PlainConsole(file=shown, force_terminal=True, color_system="standard", width=60)
    table = Table("a\x1b[2J")
    table.add_row("b\x1b]0;title\x07")
    console.print(table, "c\x9b31m", style="red")
    text = shown.getvalue()
    assert "\x1b[31m" in text, "its own colours stay"
    assert "\x1b[2J" not in text
    assert "\x07" not in text
    assert "\x9b" not in text


def test_errors_are_one_line_of_bounded_length() -> None:
    error = InputError("a\nb.laz", ["x" * 9000, "count 7\x1b[1m"])
    assert OBEYED.search(str(error)) is None
    assert [len(fault) <= FAULT_MAX for fault in error.faults] == [True, True]
    assert "\n" not in str(StoreError("a\nb"))
    assert one_line(ValueError("a\x1bb")) == "ValueError: a\\x1bb"
    assert shortened("abc", 3) == "abc"
    assert shortened("a" * 50 + "b" * 50, 30) == "a" * 20 + " … " + "b" * 7


@pytest.fixture(scope="module")
def hostile(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, surveys.Ended]:
    """A run on files of hostile names, two of which cannot be used."""
    folder = tmp_path_factory.mktemp("hostile")
    for k, name in enumerate(HOSTILE):
        line = surveys.flightline(shots=8, psid=k + 1, start_s=surveys.START_S + k, seed=k)
        plain_path = surveys.write_cloud(folder / "lines" / "a.laz", line)
        if k == 0:
            content = plain_path.read_bytes()
            for user, number in ((b"LASF_Projection", 2111), (b"\x1b[31m\xff", 1)):
                content = with_record(content, user, number, b"PROJCS[\xff\x1b[2J")
            plain_path.write_bytes(content)
        plain_path.rename(folder / "lines" / name)
    (folder / "lines" / "bad\x1b[1m<b>.laz").write_bytes(b"junk")
    os.rename(  # noqa: PTH104 - bytes, as no text can name it
        surveys.write_cloud(folder / "lines" / "b.laz", surveys.flightline(shots=8)),
        os.fsencode(folder) + b"/lines/bad\xff\xfe.laz",
    )
    name = {"name": "<img src=x onerror=alert(1)>$\\frac{$ \x1b[31m\u202e"}
    workflow = surveys.write_workflow(folder, survey=name)
    return folder, surveys.command("run", workflow, "--workers", 0)


def test_hostile_names_are_only_shown(hostile: tuple[Path, surveys.Ended]) -> None:
    folder, ended = hostile
    assert ended.status == 1, ended.text
    assert "bad\\x1b[1m<b>.laz" in ended.err
    assert "bad\\xff\\xfe.laz" in ended.err
    others = (("status", folder / "out"), ("plan", folder / "workflow.yaml"))
    for text in (ended.text, *(surveys.command(*arguments).text for arguments in others)):
        assert OBEYED.search(text) is None
    delivered = {path.name for path in (folder / "out/laz/lines").iterdir()}
    assert delivered == set(HOSTILE)


def test_hostile_names_are_text_in_the_report(hostile: tuple[Path, surveys.Ended]) -> None:
    folder, _ = hostile
    page = (folder / "out/report.html").read_bytes().decode()
    assert OBEYED.search(page) is None
    assert "<script>alert" not in page
    assert "<script" not in page
    assert "<img src=x" not in page
    assert "&lt;img src=x onerror=alert(1)&gt;" in page
    assert "{{7*7}}" in page, "no template of ours"
    report = surveys.report(folder / "out")
    assert report["survey"]["name"].startswith("<img src=x"), "data stay what they are"
