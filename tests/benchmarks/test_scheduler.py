"""What handing out tasks costs is measured on a survey that phases understand."""

import pytest

from benchmarks.engine.scheduler import SPACE, client


def test_a_made_up_survey_goes_through_the_phases(capsys: pytest.CaptureFixture[str]) -> None:
    client(900, 4 * 2**30)
    lines = [line.split() for line in capsys.readouterr().out.splitlines()]
    tasks = {line[0]: int(line[1].replace(",", "")) for line in lines if line[0] in SPACE}
    assert list(tasks) == list(SPACE)
    assert tasks["build_tile"] == 900
    assert min(tasks.values()) > 0
