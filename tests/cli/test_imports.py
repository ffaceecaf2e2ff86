"""What a command needs not it does not load, and what is missing it names in one line."""

import subprocess
import sys
from pathlib import Path

import pytest

from tests import surveys

FOREIGN = ("matplotlib", "h5py", "skimage", "sklearn", "pystac", "s3fs", "xarray", "bokeh")
"""Packages of reports, of other receivers, of clusters and object stores."""

WITHOUT = """
import sys
from importlib import metadata

hidden, known = {*sys.argv.pop(1).split()}, metadata.version
sys.modules.update(dict.fromkeys(hidden))

def version(name):
    if name.replace("scikit-", "sk") in hidden:
        raise metadata.PackageNotFoundError(name)
    return known(name)

metadata.version = version
from spl_batch.cli import main
try:
    main(sys.argv[1:])
except SystemExit as end:
    print("ended with", end.code, "loaded", [name for name in hidden if sys.modules[name]])
"""
"""A command, where packages are neither to be imported nor known to be installed."""


def python(code: str, *arguments: object) -> str:
    found = subprocess.run(  # noqa: S603 - the text above
        [sys.executable, "-c", code, *map(str, arguments)],
        capture_output=True,
        text=True,
        check=False,
    )
    assert "Traceback" not in found.stderr, found.stderr
    return found.stdout + found.stderr


@pytest.mark.slow
def test_a_filter_run_needs_nothing_of_reports_and_other_receivers(
    small_lines: Path, tmp_path: Path
) -> None:
    line = small_lines.parent / "lines" / "line_1.laz"
    known = [f"--set=acquisition.prf_hz={surveys.PRF_HZ}", "--set=acquisition.gate_m=60"]
    output = python(
        WITHOUT, " ".join(FOREIGN), "denoise", line, tmp_path / "o.laz", "--workers", 0, *known
    )
    assert "ended with 0 loaded []" in output, output
    assert (tmp_path / "o.laz").exists()


@pytest.mark.parametrize(
    ("verb", "file", "extra"),
    [("simulate", "water_scene.yaml", "geiger"), ("plan", "altimetry.yaml", "altimetry")],
)
def test_a_receiver_names_the_package_that_it_lacks(
    tmp_path: Path, verb: str, file: str, extra: str
) -> None:
    options = [tmp_path / "out"] if verb == "simulate" else []
    output = python(WITHOUT, "h5py", verb, Path(__file__).parents[2] / "workflows" / file, *options)
    assert "need the package h5py, which is not installed; " in output
    assert f"pip install 'spl-batch[{extra}]'" in output
    assert "ended with 2" in output


@pytest.mark.parametrize("verb", ["plan", "run"])
def test_a_run_that_could_write_no_report_does_not_begin(
    verb: str, small: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "matplotlib", None)  # type: ignore[arg-type]
    ended = surveys.command(verb, small)
    assert ended.status == 2
    assert "reports need the package matplotlib" in ended.err
    assert not (small.parent / "out").exists()
