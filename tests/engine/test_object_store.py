"""The working store on an object store: S3 as moto speaks it on the loopback."""

import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import boto3
import fsspec
import pytest
from moto.server import ThreadedMotoServer

from spl_batch import api
from spl_batch.engine.store.working_store import Store, read_receipts
from spl_batch.engine.tasks import runner
from spl_batch.engine.tasks.task import Receipt
from spl_batch.errors import StoppedError, WorkflowError
from spl_batch.formats.files import remote
from tests import surveys

Results = dict[str, bytes]

PHRASE = "a-secret-that-nobody-writes-down"


@pytest.fixture(scope="module")
def bucket() -> Iterator[str]:
    """URL of a bucket; everything about it comes from the usual environment."""
    server = ThreadedMotoServer(ip_address="127.0.0.1", port=0, verbose=False)
    server.start()
    host, port = server.get_host_and_port()
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("AWS_ENDPOINT_URL", f"http://{host}:{port}")
        patch.setenv("AWS_ACCESS_KEY_ID", "test")
        patch.setenv("AWS_SECRET_ACCESS_KEY", PHRASE)
        patch.setenv("AWS_DEFAULT_REGION", "us-east-1")
        boto3.client("s3").create_bucket(Bucket="surveys")
        yield "s3://surveys"
    server.stop()


@pytest.fixture(scope="module")
def flown(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("flown")
    # On two tiles and two ground cells: beside one edge of theirs.
    east, north = surveys.ORIGIN_M
    line = surveys.flightline(shots=40, origin_m=(east + 40.0, north))
    surveys.write_cloud(folder / "lines" / "1.laz", line)
    surveys.write_trajectory(folder / "trajectory.csv", shift_m=40.0)
    return surveys.write_workflow(folder, ground={"cell_m": 100, "buffer_m": 20})


@pytest.fixture(scope="module")
def expected(flown: Path) -> Results:
    return surveys.results(surveys.run(flown, until="deliver").output)


@pytest.fixture
def survey(flown: Path, tmp_path: Path) -> Path:
    return surveys.copy_of(flown, tmp_path)


def keys(prefix: str) -> list[str]:
    pages = boto3.client("s3").get_paginator("list_objects_v2")
    found = pages.paginate(Bucket="surveys", Prefix=f"{prefix}/")
    return [item["Key"] for page in found for item in page.get("Contents", ())]


def test_results_are_those_of_a_local_store(
    survey: Path, expected: Results, bucket: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    url = f"outputs.store={bucket}/one"
    run_task = runner.run_task
    calls = 0

    def killed(*args: Any) -> Receipt:
        nonlocal calls
        calls += 1
        if calls == 7:
            raise KeyboardInterrupt
        return run_task(*args)

    with monkeypatch.context() as patch:
        patch.setattr(runner, "run_task", killed)
        with pytest.raises(KeyboardInterrupt):
            surveys.run(survey, url, until="deliver")
    result = surveys.run(survey, url)
    assert result.exit_status == 0
    assert result.report is not None
    assert surveys.results(result.output) == expected
    there = keys("one")
    assert {k.split("/")[1] for k in there} >= {"receipts", "tiles", "voxels", "fired", "denoise"}
    local = {p.name for p in (result.output / "store").iterdir()}
    assert local == {"lock", "run.json", "noise.tif"}
    held = [path for path in survey.parent.rglob("*") if path.is_file()]
    assert not [path for path in held if PHRASE.encode() in path.read_bytes()]
    bodies = (boto3.client("s3").get_object(Bucket="surveys", Key=k)["Body"].read() for k in there)
    assert not any(PHRASE.encode() in body for body in bodies), "keys are written nowhere"
    assert api.report(result.output).report.counts == result.report.counts
    # Nothing is done twice; what is damaged there is made again.
    before = {r.name: r for r in read_receipts(Store(result.output, f"{bucket}/one"), "scatter")}
    client = boto3.client("s3")
    client.delete_object(Bucket="surveys", Key=next(k for k in there if "/voxels/" in k))
    client.put_object(Bucket="surveys", Key=next(k for k in there if "/tiles/" in k), Body=b"PAR1")
    again = surveys.run(survey, url, until="deliver")
    assert again.exit_status == 0
    assert surveys.results(again.output) == expected
    after = {r.name: r for r in read_receipts(Store(result.output, f"{bucket}/one"), "scatter")}
    assert {k: r.digest for k, r in after.items()} == {k: r.digest for k, r in before.items()}
    surveys.run(survey, url, until="index", fresh=True)
    assert {k.split("/")[2] for k in keys("one") if "/receipts/" in k} == {
        "index_file",
        "index_part",
        "trajectory",
        "trajectory_file",
    }


def test_a_store_belongs_to_one_output(survey: Path) -> None:
    place = "outputs.store=memory://shared"
    surveys.run(survey, place, until="index")
    other = surveys.copy_of(survey, survey.parent / "other")
    for options in ({}, {"fresh": True}):
        with pytest.raises(WorkflowError) as caught:
            surveys.run(other, place, until="index", **options)
        assert f"is the store of another output, {survey.parent / 'out'} (host" in str(caught.value)
        assert "name another one, or delete what is there" in str(caught.value)
    assert surveys.run(survey, place, until="index", fresh=True).exit_status == 0
    with pytest.raises(WorkflowError, match="another output"):
        surveys.run(other, place, until="index")
    fsspec.filesystem("memory").rm("/shared", recursive=True)
    assert surveys.run(other, place, until="index").exit_status == 0


def test_a_store_that_is_not_there_stops_the_run(
    survey: Path, monkeypatch: pytest.MonkeyPatch, bucket: str
) -> None:
    with pytest.raises(StoppedError, match="run again"):
        surveys.run(survey, f"outputs.store={bucket}-not-there/one", until="index")
    with pytest.raises(WorkflowError, match="store"):
        surveys.run(survey, "outputs.store=no-url")
    monkeypatch.setitem(sys.modules, "gcsfs", None)
    with pytest.raises(WorkflowError, match=r"pip install 'spl-batch\[cluster\]'"):
        remote.remote_path("gs://surveys/elsewhere")
