"""What programs read: one JSON document on standard output; and what a shell completes."""

import json
from pathlib import Path
from typing import Any

import pytest

from tests import surveys


def document(*arguments: Any, status: int = 0) -> dict[str, Any]:
    ended = surveys.command(*arguments, "--json")
    content: dict[str, Any] = json.loads(ended.out)  # one document and nothing beside it
    assert content["exit_status"] == ended.status == status
    return content


def test_plan_run_and_status_give_one_document_each(small: Path) -> None:
    plan = document("plan", small)
    assert (plan["files"], plan["faults"], plan["finished"]) == (2, [], 0)
    assert plan["cost"]["time_s"] > 0
    run = document("run", small, "--workers", 0)
    assert run["counts"]["points_in"] == run["counts"]["points_out"] == plan["cost"]["points"]
    assert Path(run["results"]["report"][0]).exists()
    assert run["failures"] == []
    status = document("status", run["output"])
    assert status["state"] == "ended"
    assert status["ended"] == {"exit_status": 0, "reason": ""}
    assert status["stages"]["deliver"]["done"] == status["stages"]["deliver"]["total"] > 0
    plan = document("plan", small)
    assert plan["finished"] > 10


def test_faults_and_errors_are_in_the_document(small: Path, tmp_path: Path) -> None:
    (small.parent / "lines" / "broken.laz").write_bytes(b"LASF")
    (fault,) = document("plan", small, status=1)["faults"]
    assert "broken.laz" in fault
    error = document("run", tmp_path / "no.yaml", status=2)
    assert error.keys() == {"exit_status", "error"}
    assert "no.yaml" in error["error"]
    assert surveys.command("run", tmp_path / "no.yaml").out == ""  # no document unless asked for
    usage = document("status", tmp_path, "--watch", status=2)["error"]
    assert usage == "--json prints one document: leave out --watch"
    assert "No such option" in document("run", tmp_path, "--wrong", status=2)["error"]


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_a_shell_learns_to_complete(shell: str) -> None:
    ended = surveys.command("completion", shell)
    assert ended.status == 0
    assert f"_SPL_BATCH_COMPLETE={shell}_complete" in ended.out
    assert surveys.command("completion", "csh").status == 2
