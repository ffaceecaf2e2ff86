"""What a run delivers beside the points: headers by the values, waveforms, refusals of COPC."""

from pathlib import Path

import laspy
import pytest

from tests import surveys
from tests.io_files import patch

LINEAR = {"filter": {"method": "none"}, "afterpulse": {"enabled": False}}


@pytest.fixture(scope="module")
def survey(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A cloud of point format 4 with waveforms in a file beside it, and the wrong bit of time."""
    folder = tmp_path_factory.mktemp("waves")
    cloud = folder / "lines" / "a.las"
    columns = surveys.flightline(shots=60, psid=1, start_s=surveys.START_S, seed=1)
    surveys.write_cloud(cloud, columns, version="1.3", point_format=4)
    patch(cloud, 6, "H", 4)
    cloud.with_suffix(".wdp").write_bytes(b"waves")
    return folder


def test_octrees_of_waveforms_are_refused_by_the_plan(survey: Path) -> None:
    workflow = surveys.write_workflow(survey, **LINEAR, outputs={"copc": True})
    ended = surveys.command("plan", workflow)
    assert ended.status == 2
    assert "outputs.copc: lines/a.las: point format 4" in ended.err


def test_waveforms_and_a_header_by_the_values(survey: Path) -> None:
    workflow = surveys.write_workflow(survey, **LINEAR)
    ended = surveys.command("run", workflow, "--workers", 0)
    assert ended.status == 0, ended.text
    lines = survey / "out" / "laz" / "lines"
    assert (lines / "a.wdp").read_bytes() == b"waves"
    encoding = laspy.read(lines / "a.laz").header.global_encoding
    assert encoding.gps_time_type == laspy.header.GpsTimeType.STANDARD
    assert encoding.waveform_data_packets_external
    assert encoding.wkt
    changes = surveys.report(survey / "out")["header_changes"]
    assert {changes[name] for name in ("gps_time_bit", "wkt_bit", "generating_software")} == {1}
    assert "waveform_bits" not in changes
    assert "lines/a.wdp" in (survey / "out/delivered.json").read_text()
