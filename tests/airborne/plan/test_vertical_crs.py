"""The vertical datum of a survey: what its files name, or the workflow for those that do not."""

from pathlib import Path

import laspy
import numpy as np
import pytest
from pyproj import CRS

from spl_batch.airborne.context import reprojection
from spl_batch.airborne.plan.inputs.survey_inputs import Inputs, gather_inputs
from spl_batch.airborne.settings import OutputSettings
from spl_batch.airborne.settings.workflow import Workflow
from spl_batch.engine.report.reported import reported
from spl_batch.errors import WorkflowError
from spl_batch.formats.crs import WKT_KEY, compound, horizontal, in_unit, vertical
from spl_batch.formats.heights import SOME_HEIGHTS, names_datum
from spl_batch.formats.las.header import read_header
from spl_batch.formats.las.known_records import kept_records
from spl_batch.formats.units import US_FOOT, Units
from tests import surveys
from tests.io_files import keys_record

UTM, NAVD88, EGM96 = "EPSG:32615", "EPSG:32615+5703", "EPSG:32615+5773"
FEET, FEET_NAVD88, HALF = "EPSG:2278", "EPSG:2278+6360", "EPSG:2278+5703"
UNKNOWN_FEET = compound(CRS(FEET), in_unit(SOME_HEIGHTS, US_FOOT)).to_wkt()


def gathered(folder: Path, files: list[str | None], **survey: str) -> Inputs:
    for k, text in enumerate(files):
        surveys.write_cloud(folder / f"{k}.laz", surveys.flightline(shots=5), crs=text)
    content = {"survey": {"flightlines": "*.laz", **survey}, "output": "out"}
    workflow = Workflow.model_validate(content)
    return gather_inputs(workflow, folder, folder / "out")


def code(crs: CRS | None) -> int | None:
    part = None if crs is None else vertical(crs)
    return None if part is None else part.to_epsg()


@pytest.mark.parametrize(
    ("crs", "survey", "wanted"),
    [
        ([UTM, UTM], {}, None),
        ([NAVD88, NAVD88], {}, 5703),
        ([NAVD88, NAVD88], {"vertical_crs": "EPSG:5703"}, 5703),
        ([UTM, UTM], {"vertical_crs": "EPSG:5703"}, 5703),
        ([None, None], {"crs": NAVD88}, 5703),
        ([UTM, None], {"crs": NAVD88}, 5703),
        ([UTM, NAVD88], {"crs": NAVD88}, 5703),
        ([UTM, NAVD88], {"vertical_crs": "EPSG:5703"}, 5703),
        ([UNKNOWN_FEET, FEET_NAVD88], {"vertical_crs": "EPSG:6360"}, 6360),
    ],
)
def test_a_survey_has_the_vertical_datum_of_its_files(tmp_path, crs, survey, wanted) -> None:
    inputs = gathered(tmp_path, crs, **survey)
    assert code(inputs.crs) == wanted
    assert inputs.crs is not None
    assert len(inputs.sources) == len(crs)
    assert not surveys.found(inputs.warnings, "I08", "vertical")


def test_files_of_another_datum_are_bad_and_those_of_none_are_told(tmp_path: Path) -> None:
    inputs = gathered(tmp_path, [NAVD88, NAVD88, EGM96, UTM])
    assert code(inputs.crs) == 5703
    assert [Path(fault.path).name for fault in inputs.bad] == ["2.laz"]
    assert "its heights are 'EGM96 height' (EPSG:5773), the survey's 'NAVD88 height'" in str(
        inputs.bad[0]
    )
    (one,) = surveys.found(inputs.warnings, "I08", "vertical")
    assert one.subject == "3.laz"
    assert "NAVD88" in one.values["crs"]


@pytest.mark.parametrize(
    ("files", "wanted", "named"),
    [
        ([FEET_NAVD88, UNKNOWN_FEET], "NAVD88", ["1.laz"]),
        ([UNKNOWN_FEET] * 3 + [FEET_NAVD88], "NAVD88", ["0.laz", "1.laz", "2.laz"]),
        ([UNKNOWN_FEET, FEET, FEET_NAVD88], "NAVD88", ["0.laz", "1.laz"]),
        ([UNKNOWN_FEET, FEET], "unknown", ["1.laz"]),
        ([UNKNOWN_FEET] * 2, "unknown", []),
        ([CRS(UTM).to_3d().to_wkt(), UTM], "above the ellipsoid by 'WGS 84 / UTM", ["1.laz"]),
    ],
)
def test_files_that_name_a_datum_decide_on_it_for_those_that_do_not(
    tmp_path: Path, files: list[str | None], wanted: str, named: list[str]
) -> None:
    inputs = gathered(tmp_path, files)
    assert len(inputs.sources) == len(files)
    found = surveys.found(inputs.warnings, "I08", "vertical")
    assert [one.subject for one in found] == named
    assert all(wanted in one.values["crs"] for one in found)
    assert inputs.crs is not None
    delivered = set()
    for source in inputs.sources:
        header = read_header(source.path)
        vlrs, evlrs, _ = kept_records(header, inputs.crs)
        delivered.update(
            names_datum(CRS(one.data.rstrip(b"\0").decode())) for one in vlrs if one.key == WKT_KEY
        )
        assert not evlrs
    if wanted == "NAVD88":
        assert delivered == {True}
        assert code(inputs.crs) == 6360


def test_a_survey_crs_of_places_alone_says_nothing_of_heights(tmp_path: Path) -> None:
    inputs = gathered(tmp_path, [UTM, NAVD88], crs=UTM)
    (one,) = surveys.found(inputs.warnings, "I08", "vertical")
    assert one.subject == "0.laz"


def test_a_file_of_heights_that_have_a_name_alone_has_a_vote(tmp_path: Path) -> None:
    named = UNKNOWN_FEET.replace('VERTCRS["unknown"', 'VERTCRS["EGM96 height (ftUS)"')
    inputs = gathered(tmp_path, [named, named, FEET_NAVD88])
    assert [Path(fault.path).name for fault in inputs.bad] == ["2.laz"]
    assert vertical(inputs.crs).name == "EGM96 height (ftUS)"


def test_a_record_of_a_unit_alone_is_kept_where_the_survey_knows_no_more(tmp_path: Path) -> None:
    path = surveys.write_cloud(tmp_path / "0.laz", surveys.flightline(shots=5), crs=UNKNOWN_FEET)
    survey = CRS(UNKNOWN_FEET.replace('VERTCRS["unknown"', 'VERTCRS["user-defined"'))
    header = read_header(path)
    assert kept_records(header, survey)[0] == [one for one in header.vlrs if one.key == WKT_KEY]


def test_a_file_without_a_crs_beside_others_is_told(tmp_path: Path) -> None:
    inputs = gathered(tmp_path, [FEET, FEET, None])
    (one,) = surveys.found(inputs.warnings, "I08", "others")
    assert one.subject == "2.laz"
    assert "EPSG:2278" in one.values["crs"]
    assert one.values["unit"] == "US survey feet"
    inputs = gathered(tmp_path, [FEET, FEET, None], crs=FEET)
    assert not surveys.found(inputs.warnings, "I08", "others")


def test_without_any_crs_a_remedy_for_feet_is_named(tmp_path: Path) -> None:
    (one,) = reported(gathered(tmp_path, [None]).warnings)
    assert (one.code, one.values["kind"]) == ("I08", "none")
    assert "taken as metres" in one.sentence
    assert "EPSG:...+6360" in one.sentence


def test_a_named_datum_contradicts_no_file(tmp_path: Path) -> None:
    with pytest.raises(WorkflowError, match="vertical_crs: the files state 'NAVD88 height'"):
        gathered(tmp_path, [NAVD88], vertical_crs="EPSG:5773")


@pytest.mark.parametrize(
    ("files", "survey", "wanted", "bad"),
    [
        ([FEET, FEET, HALF], {}, None, ["2.laz"]),
        ([FEET, HALF, HALF], {}, 5703, ["0.laz"]),
        ([FEET, FEET, FEET_NAVD88], {}, 6360, []),
        ([FEET_NAVD88, FEET_NAVD88, HALF], {}, 6360, ["2.laz"]),
        ([FEET, HALF, HALF], {"vertical_crs": "EPSG:5703"}, 5703, []),
        ([FEET, FEET, HALF], {"vertical_crs": "EPSG:5703"}, 5703, []),
        ([FEET, FEET, HALF], {"vertical_crs": "EPSG:6360"}, 6360, ["2.laz"]),
        ([FEET, FEET, HALF], {"crs": HALF}, 5703, []),
        ([UTM, UTM, "EPSG:32615+6360"], {}, None, ["2.laz"]),
    ],
)
def test_most_points_decide_on_the_unit_of_heights(
    tmp_path: Path, files: list[str | None], survey: dict[str, str], wanted, bad: list[str]
) -> None:
    inputs = gathered(tmp_path, files, **survey)
    assert code(inputs.crs) == wanted
    assert [Path(fault.path).name for fault in inputs.bad] == bad
    assert all("US survey feet" in str(fault) and "metres" in str(fault) for fault in inputs.bad)


@pytest.mark.parametrize(
    ("survey", "reference", "stated", "fault"),
    [
        (HALF, FEET, None, r"states no unit of heights.* reference\.crs: EPSG:2278"),
        (HALF, FEET, HALF, ""),
        (HALF, FEET, FEET_NAVD88, "heights are in US survey feet .* survey's in metres"),
        (HALF, UNKNOWN_FEET, HALF, "heights are in US survey feet .* in metres"),
        (FEET_NAVD88, UNKNOWN_FEET, HALF, "are in US survey feet .*, reference.crs in metres"),
        (FEET_NAVD88, UNKNOWN_FEET, FEET_NAVD88, ""),
        (FEET, FEET, None, ""),
        (FEET_NAVD88, FEET, None, ""),
        (NAVD88, EGM96, None, "heights are 'EGM96 height'"),
        (None, UTM, None, r"name it in survey\.crs"),
        (UTM, UTM, "EPSG:32616", r"is not reference\.crs 'WGS 84 / UTM zone 16N'.*leave out refer"),
        (NAVD88, NAVD88, EGM96, r"are 'NAVD88.*, reference\.crs 'EGM96.*or leave out reference"),
        (NAVD88, NAVD88, UTM, ""),
        (NAVD88, UTM, NAVD88, ""),
        (None, None, None, ""),
    ],
)
def test_heights_of_a_reference_are_the_surveys_by_what_is_stated(
    tmp_path: Path, survey: str | None, reference: str | None, stated: str | None, fault: str
) -> None:
    surveys.write_cloud(tmp_path / "ref.las", surveys.flightline(shots=5), crs=reference)
    settings = {"points": "ref.las"} | ({} if stated is None else {"crs": stated})
    surveys.write_cloud(tmp_path / "0.laz", surveys.flightline(shots=5), crs=survey)
    content = {"survey": {"flightlines": "*.laz"}, "reference": settings, "output": "out"}
    workflow = Workflow.model_validate(content)
    if fault:
        with pytest.raises(WorkflowError, match=f"reference.points: .*{fault}"):
            gather_inputs(workflow, tmp_path, tmp_path / "out")
    else:
        assert gather_inputs(workflow, tmp_path, tmp_path / "out").reference.usable


def test_heights_above_the_ellipsoid_are_those_of_their_own_survey(tmp_path: Path) -> None:
    for name in ("EPSG:6588", UTM):
        deep = CRS(name).to_3d()
        inputs = gathered(tmp_path, [deep.to_wkt()] * 2 + [f"{name}+5703"])
        assert inputs.crs == deep
        assert [Path(fault.path).name for fault in inputs.bad] == ["2.laz"]
        assert "heights are 'NAVD88 height' (EPSG:5703), the survey's above the" in str(inputs.bad)
        assert Units.of(inputs.crs).vertical == "metre"
        assert not surveys.found(inputs.warnings, "I08")
        (tmp_path / "2.laz").unlink()
        assert gathered(tmp_path, [name] * 2, crs=deep.to_wkt()).crs == deep
        with pytest.raises(WorkflowError, match=r"vertical_crs: .* above the ellipsoid"):
            gathered(tmp_path, [deep.to_wkt()] * 2, vertical_crs="EPSG:5703")


def test_tasks_share_what_leads_to_another_crs_whose_name_needs_no_grid() -> None:
    crs, outputs = CRS("EPSG:2994"), OutputSettings(crs="EPSG:2992")
    found = reprojection(outputs, crs)
    assert found is not None
    assert found.crs.to_epsg() == 2992
    assert reprojection(outputs, CRS("EPSG:2994")) is found
    with pytest.raises(WorkflowError, match="pyproj sync --file"):
        found.check(np.array([[800_000.0, 900_000.0, 10.0]]))


LOCAL, FOOT, US_FOOT = (1024, 32767), 9002, 9003


@pytest.mark.parametrize(
    ("keys", "survey", "wanted"),
    [
        ([LOCAL], UTM, (32615, None)),
        ([LOCAL, (3076, 9001)], NAVD88, (32615, 5703)),
        ([LOCAL, (4096, 5703)], UTM, (32615, 5703)),
        ([LOCAL, (4096, 5703), (4099, 9001)], UTM, (32615, 5703)),
        ([(1024, 3)], UTM, (32615, None)),
        ([LOCAL, (3076, FOOT)], UTM, None),
        ([LOCAL, (4096, 6360)], UTM, None),
        ([LOCAL, (4099, US_FOOT)], UTM, None),
        ([LOCAL, (4096, 5703)], NAVD88.replace("5703", "5773"), None),
    ],
)
def test_survey_crs_stands_for_a_record_that_names_none_unless_that_is_in_feet(
    tmp_path: Path,
    keys: list[tuple[int, int]],
    survey: str,
    wanted: tuple[int, int | None] | None,
) -> None:
    path = surveys.write_cloud(tmp_path / "0.las", surveys.flightline(shots=5), crs=None)
    cloud = laspy.read(path)
    cloud.header.vlrs.append(keys_record(*keys))
    cloud.header.global_encoding.wkt = False
    cloud.write(path)
    inputs = gathered(tmp_path, [], flightlines="*.las", crs=survey)
    if wanted is None:
        assert not inputs.sources
        assert len(inputs.bad) == 1
    else:
        assert horizontal(inputs.crs).to_epsg() == wanted[0]
        assert code(inputs.crs) == wanted[1]
        (finding,) = inputs.warnings
        assert (finding.code, finding.subject) == ("I01", "0.las")
        assert "survey.crs" in finding.values["what"]
