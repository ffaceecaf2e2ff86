"""What `docs/security.md` promises: who listens, what is encrypted, what is never executed."""

import contextlib
import io
import json
import os
import pickle
import re
import socket
import subprocess
import sys
import zipfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import dask
import distributed
import numpy as np
import psutil
import pytest
import yaml

from spl_batch.engine.flow import cluster
from spl_batch.engine.flow.cluster import local_cluster
from spl_batch.errors import DamagedError, InputError
from spl_batch.formats.files.atomic import write_bytes
from spl_batch.formats.verified.parquet_npz import read_arrays
from spl_batch.geiger.water.formats import inspect_frames, iter_frames
from tests import clusters, surveys
from tests.clusters import ROOT
from tests.workflow_files import blocks

PAGE = ROOT / "docs/security.md"
LOOPBACK = {"127.0.0.1", "::1"}


def listening(process: psutil.Process) -> set[tuple[int, str, int]]:
    """Process, address and port where a process and its children listen."""
    found = ((p.pid, p.net_connections("inet")) for p in (process, *process.children(True)))  # noqa: FBT003
    listed = ((pid, c) for pid, connections in found for c in connections)
    return {(pid, *c.laddr) for pid, c in listed if c.status == psutil.CONN_LISTEN}


def test_local_workers_listen_on_loopback_alone() -> None:
    before = listening(psutil.Process())  # servers of other tests
    with local_cluster(1, 1 << 30):
        addresses = {ip for _, ip, _ in listening(psutil.Process()) - before}
    assert addresses
    assert addresses <= LOOPBACK


# TLS


@contextlib.contextmanager
def started(folder: Path, name: str, *command: str) -> Iterator[Path]:
    """A process of dask's own with the page's settings; the file that holds what it prints."""
    output = folder / f"{name}.txt"
    with output.open("wb") as stream:
        process = subprocess.Popen(  # noqa: S603
            [sys.executable, "-m", "dask", *command],
            cwd=folder,
            env=encrypted(folder),
            stdout=stream,
            stderr=stream,
        )
    try:
        yield output
    finally:
        process.kill()
        process.wait()


def encrypted(folder: Path) -> dict[str, str]:
    """Environment in which dask finds the page's settings."""
    return {**os.environ, "DASK_CONFIG": str(folder / "dask"), "PYTHONPATH": str(ROOT)}


@pytest.mark.slow
def test_the_example_of_a_cluster_with_tls_works(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    keys, *_ = blocks(PAGE, "sh")
    command = ["bash", "-euc", keys]
    made = subprocess.run(command, cwd=tmp_path, capture_output=True, check=False)  # noqa: S603
    assert made.returncode == 0, made.stderr.decode()
    settings = yaml.safe_load(blocks(PAGE, "yml")[0].replace("/secrets", str(tmp_path)))
    (tmp_path / "dask").mkdir()
    (tmp_path / "dask/tls.yaml").write_text(yaml.safe_dump(settings))
    surveys.write_cloud(tmp_path / "lines/1.laz", surveys.flightline(shots=25))
    workflow = surveys.write_workflow(tmp_path)
    scheduler_file = tmp_path / "scheduler.json"
    scheduler = ("scheduler", "--protocol", "tls", "--host", "127.0.0.1", "--port", "0")
    worker = ("worker", "--scheduler-file", str(scheduler_file), "--nthreads", "1", "--no-nanny")
    common = ("--no-dashboard",)
    with (
        started(tmp_path, "s", *scheduler, "--scheduler-file", str(scheduler_file), *common),
        started(tmp_path, "w", *worker, *common) as output,
    ):
        clusters.wait_until(lambda: "Registered to" in output.read_text())
        address = json.loads(scheduler_file.read_text())["address"]
        assert address.startswith("tls://127.0.0.1:")
        with dask.config.set(dask.config.merge(distributed.config, settings)):
            ended = surveys.command(
                *("run", workflow, "--scheduler", address),
                *("--memory", "1GiB", "--until", "deliver"),
            )
        assert ended.status == 0, ended.text
        assert (tmp_path / "out/laz/lines/1.laz").exists()
        brief = {**cluster.SETTINGS, "distributed.comm.timeouts.connect": "1s"}
        monkeypatch.setattr(cluster, "SETTINGS", brief)  # it would ask again for ten seconds
        without = surveys.command("run", workflow, "--scheduler", address, "--fresh")
        assert without.status == 3, "who has no key gets no answer"


# Nothing is executed


EXECUTES = re.compile(
    r"^\s*(import|from) (pickle|cPickle|dill|cloudpickle|joblib|marshal|shelve)\b"
    r"|(^|[\s(=])(eval|exec)\(|allow_pickle=(?!False)",
    flags=re.MULTILINE,
)


def test_nothing_of_ours_unpickles_or_evaluates() -> None:
    for path in sorted((ROOT / "spl_batch").rglob("*.py")):
        found = EXECUTES.search(path.read_text(encoding="utf-8"))
        assert found is None, f"{path}: {found}"


class Executed:
    """Writes a file when it is unpickled."""

    def __init__(self, mark: Path) -> None:
        self.mark = mark

    def __reduce__(self) -> Any:
        return Path.touch, (self.mark,)


def test_a_pickle_in_the_store_is_damage(tmp_path: Path) -> None:
    mark = tmp_path / "executed"
    content = io.BytesIO()
    np.savez(content, a=np.array([Executed(mark)], dtype=object))
    with zipfile.ZipFile(content) as made:
        assert b"Executed" in made.read("a.npy") or b"touch" in made.read("a.npy")
    (tmp_path / "a.npz").write_bytes(content.getvalue())
    with pytest.raises(DamagedError):
        read_arrays(tmp_path / "a.npz")
    assert not mark.exists()


PICKLE = {"id": "pickle", "protocol": 5}
SHUFFLE = {"id": "shuffle", "elementsize": 2}


@pytest.mark.parametrize(
    ("compressor", "filters"),
    [(None, [PICKLE]), (PICKLE, None), (PICKLE, [SHUFFLE]), (None, [SHUFFLE, PICKLE])],
)
def test_a_pickle_in_an_input_is_never_unpickled(
    tmp_path: Path, compressor: Any, filters: Any
) -> None:
    """Zarr knows a codec of that name; frames that ask for it are refused."""
    group, mark = tmp_path / "f.zarr", tmp_path / "executed"
    (group / "frames").mkdir(parents=True)
    (group / ".zgroup").write_text('{"zarr_format": 2}')
    array = {"zarr_format": 2, "shape": [10, 4, 5], "chunks": [10, 4, 5], "dtype": "<u2"}
    array |= {"compressor": compressor, "filters": filters, "fill_value": 0, "order": "C"}
    (group / "frames/.zarray").write_text(json.dumps(array))
    (group / "frames/0.0.0").write_bytes(pickle.dumps(Executed(mark)))
    with pytest.raises(InputError):
        inspect_frames(group, 4, 5)
    with pytest.raises(InputError):
        list(iter_frames(group, 0, 10, 1000))
    assert not mark.exists()


@pytest.fixture
def survey(tmp_path: Path) -> Path:
    surveys.write_cloud(tmp_path / "s/lines/1.laz", surveys.flightline(shots=10))
    return surveys.write_workflow(tmp_path / "s")


def test_a_link_in_place_of_a_file_is_replaced_and_not_followed(tmp_path: Path) -> None:
    elsewhere, path = tmp_path / "elsewhere", tmp_path / "dtm.tif"
    elsewhere.write_bytes(b"kept")
    path.symlink_to(elsewhere)
    write_bytes(path, b"made")
    assert elsewhere.read_bytes() == b"kept"
    assert path.read_bytes() == b"made"
    assert not path.is_symlink()


# Ports, limits, what is installed


def test_a_run_without_workers_opens_no_port(survey: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object) -> None:
        raise AssertionError("a port is opened")

    for method in ("bind", "listen", "connect"):
        monkeypatch.setattr(socket.socket, method, refuse)
    ended = surveys.command("run", survey, "--workers", 0, "--until", "index")
    assert ended.status == 0, ended.text
