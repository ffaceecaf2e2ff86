"""Input files as every receiver's plan names them: where they may lie, what results are called."""

from dataclasses import dataclass
from pathlib import Path

import pytest

from spl_batch.engine.plan.input_files import check_keys, expand, refuse_own, stem_names
from spl_batch.errors import WorkflowError
from spl_batch.formats.crs import projected_crs


@dataclass
class File:
    """A source that only has names."""

    name: str
    key: int

    @property
    def path(self) -> Path:
        return Path(self.name)


def test_inputs_among_the_results_are_a_fault() -> None:
    faults: list[str] = []
    paths = [Path("/s/a.h5"), Path("/s/out/b.h5"), Path("/s/out/c/d.h5")]
    refuse_own(paths, Path("/s/out"), "track.photons", faults)
    assert len(faults) == 1
    assert faults[0].startswith("track.photons: /s/out/b.h5 and 1 more in the output folder /s/out")
    refuse_own(paths[:1], Path("/s/out"), "track.photons", faults)
    assert len(faults) == 1


@pytest.mark.parametrize(
    ("name", "matches"),
    [
        ("lines/*.laz", ["lines/1.laz", "lines/a [1].laz"]),
        ("lines/a [1].laz", ["lines/a [1].laz"]),
        ("{base}/lines/*[12].laz", ["lines/1.laz"]),
        ("raw [ab]/*.laz", ["raw [ab]/2.laz"]),
        ("raw [cd]/*.laz", ["raw c/3.laz"]),
        ("../Block [[]1]/lines/1.laz", ["lines/1.laz"]),
    ],
)
def test_names_of_folders_and_files_are_no_patterns(
    tmp_path: Path, name: str, matches: list[str]
) -> None:
    files = ("lines/1.laz", "lines/a [1].laz", "lines/a 1.laz", "raw [ab]/2.laz", "raw a/2.laz")
    base = tmp_path / "Block [1]"
    for file in (base / one for one in (*files, "raw c/3.laz")):
        for path in (file, tmp_path / "Block 1" / file.relative_to(base)):
            path.parent.mkdir(parents=True, exist_ok=True)
            path.touch()
    (base / "lines" / "a 1.laz").unlink()
    faults: list[str] = []
    found = expand(name.format(base=base), base, "survey.flightlines", faults)
    assert [path.relative_to(base).as_posix() for path in found] == matches
    assert not faults


def test_keys_that_clash_are_refused() -> None:
    check_keys([File("a", 1), File("b", 2), File("a", 1)])
    with pytest.raises(WorkflowError, match="share a key by chance"):
        check_keys([File("a", 1), File("b", 1)])


def test_results_of_files_of_one_name_are_distinguished() -> None:
    files = [File("a/x/f.h5", 1), File("b/x/f.h5", 2), File("g.h5", 3)]
    assert stem_names(files) == {1: "f_1", 2: "f_2", 3: "g"}


@pytest.mark.parametrize(
    ("text", "fault_text"),
    [
        ("moon", "survey.crs: 'moon' is not a known CRS"),
        ("EPSG:4326", "is geographic (degrees)"),
        ("EPSG:2277", "US survey feet"),
    ],
)
def test_a_crs_that_does_not_serve_is_one_fault_among_others(text: str, fault_text: str) -> None:
    faults = ["survey.frames: nothing matches"]
    projected_crs(text, "survey.crs", faults)
    assert len(faults) > 1
    assert all(fault.startswith("survey.crs: ") for fault in faults[1:])
    assert fault_text in faults[1]
