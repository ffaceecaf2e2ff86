"""Checkpoints: what is wrong with one leaves out that one, in a sentence that names it."""

from pathlib import Path

import numpy as np
import pyogrio
import pytest
import shapely
from pyproj import CRS, Transformer

from spl_batch.errors import InputError
from spl_batch.formats.checkpoints import read_checkpoints

UTM = CRS.from_epsg(32615)
HEAD = "id,x,y,z,surface,accuracy_m\n"


def read(path: Path, text: str, **how: object) -> tuple[list, list[str]]:
    path.write_text(text)
    return read_checkpoints(path, UTM, **how)[:2]


def test_a_csv_is_read_as_it_stands(tmp_path: Path) -> None:
    text = HEAD + "A,272000.5,3290001.25,20.125,open,0.02\nB,272003,3290004,21,Vegetated,\n"
    found, remarks = read(tmp_path / "c.csv", text)
    (remark,) = remarks
    assert remark.startswith("1 checkpoint states no accuracy_m, without which")
    assert remark.endswith(": B")
    assert (found[0].id, found[0].x_m, found[0].y_m, found[0].z_m) == (
        *("A", 272000.5, 3290001.25, 20.125),
    )
    assert [one.surface for one in found] == ["open", "vegetated"]
    assert [one.accuracy_m for one in found] == [0.02, None]


@pytest.mark.parametrize(
    "text",
    [
        "id;x;y;z\nA;272000,5;3290001.25;20,125\n",
        "ID\tX\tY\tZ\nA\t272000.5\t3290001.25\t20.125\n",
        "ID\tX\tY\tZ\nA\t272000,5\t3290001,25\t20,125\n",
        "# id   x y  z\n  A 272000.5  3290001.25 20.125 \n",
        "id, x, y, z\nA, 272000.5, 3290001.25, 20.125\n",
    ],
)
def test_semicolons_tabs_and_spaces_part_columns(tmp_path: Path, text: str) -> None:
    ((point,), remarks) = read(tmp_path / "c.csv", text, accuracy_m=0.1)
    assert (point.id, point.x_m, point.y_m, point.z_m) == ("A", 272000.5, 3290001.25, 20.125)
    assert point.surface == "open"
    assert not remarks


def test_faults_are_one_line_each_and_the_rest_is_used(tmp_path: Path) -> None:
    text = HEAD + (
        "A,1,2,3,open,0.02\n"
        "A,4,5,6,open,0.02\n"  # the same name
        "B,1.001,2,3,open,0.02\n"  # the same position
        "C,nan,2,3,open,0.02\n"
        "D,1,2,,open,0.02\n"
        "E,7,8,9,meadow,0.02\n"
        "F,7,8,9,vva,\n"
        "G,17,8,9,vva,-1\n"
    )
    found, remarks = read(tmp_path / "c.csv", text, accuracy_m=0.05)
    assert [(one.id, one.accuracy_m) for one in found] == [("A", 0.02), ("F", 0.05)]
    assert sorted(remarks) == [
        "1 checkpoint is left out, as accuracy_m is no positive number of metres: G ('-1')",
        "1 checkpoint is left out, as the surface is neither open nor vegetated: E ('meadow')",
        "2 checkpoints are left out, as an earlier one has the name or position: A, B",
        "2 checkpoints are left out, as there is no single point with finite x, y and z: C, D",
    ]


def test_another_crs_is_transformed_and_an_unknown_one_left_out(tmp_path: Path) -> None:
    east, north = 272_010.0, 3_290_010.0
    lon, lat = Transformer.from_crs(UTM, 4326, always_xy=True).transform(east, north)
    text = (
        "id,x,y,z,surface,accuracy_m,crs\n"
        f"A,{lon:.12f},{lat:.12f},20,open,0.02,EPSG:4326\n"
        "B,272000,3290000,20,open,0.02,\n"
        "C,1,2,3,open,0.02,EPSG:nonsense\n"
    )
    found, remarks = read(tmp_path / "c.csv", text)
    assert [one.id for one in found] == ["A", "B"]
    assert (found[0].x_m, found[0].y_m) == pytest.approx((east, north), abs=1e-4)
    assert len(remarks) == 2
    assert "EPSG:4326" in remarks[0]
    assert "'EPSG:nonsense' is not known: C" in remarks[1]


@pytest.mark.parametrize(
    ("file", "survey", "z_m"),
    [
        ("", "EPSG:2278+6360", 100 * 1200 / 3937),
        ("EPSG:2278+5703", "EPSG:2278+6360", 100.0),
        ("EPSG:2278", "EPSG:2278+5703", None),
        ("EPSG:2278", "EPSG:2278+6360", 100 * 1200 / 3937),
        ("EPSG:2278+6360", "EPSG:32140", 100 * 1200 / 3937),
        ("EPSG:2278", "EPSG:32140", None),
    ],
)
def test_feet_are_converted_by_the_unit_that_is_stated_and_refused_without(
    tmp_path: Path, file: str, survey: str, z_m: float | None
) -> None:
    path, crs = tmp_path / "c.csv", CRS.from_user_input(survey)
    path.write_text(f"id,x,y,z,crs\nA,3100000,13800000,100,{file}\n")
    if z_m is None:
        with pytest.raises(InputError, match=r"no unit of heights.* reference\.checkpoints_crs"):
            read_checkpoints(path, crs)
        ((point,), remarks, units) = read_checkpoints(path, crs, own=CRS(f"{file}+6360"))
        assert point.z_m == pytest.approx(100 * 1200 / 3937, abs=1e-9)
        assert "heights from US survey feet to metres" in remarks[0]
        assert units == ["US survey foot"]
        return
    ((point,), _, units) = read_checkpoints(path, crs)
    assert point.z_m == pytest.approx(z_m, abs=1e-9)
    assert units == ["metre" if z_m == 100.0 else "US survey foot"]
    if survey.startswith("EPSG:2278"):
        assert point.x_m == pytest.approx(3_100_000 * 1200 / 3937, abs=1e-6)


def test_heights_above_the_ellipsoid_are_none_above_a_geoid(tmp_path: Path) -> None:
    path = tmp_path / "c.csv"
    path.write_text("id,x,y,z,crs\nA,-95.35,29.72,20,EPSG:4979\n")
    with pytest.raises(InputError, match=r"c\.csv.* cannot be transformed from .*4979.* the grid"):
        read_checkpoints(path, CRS("EPSG:32615+5703"))
    ((point,), _, _) = read_checkpoints(path, CRS("EPSG:32615"))
    assert point.z_m == 20.0


@pytest.mark.parametrize("stated", ["EPSG:2278+6360", "EPSG:32615"])
def test_a_crs_beside_a_survey_without_one_is_refused(tmp_path: Path, stated: str) -> None:
    path = tmp_path / "c.csv"
    path.write_text(f"id,x,y,z,crs\nA,3100000,13800000,100,{stated}\n")
    with pytest.raises(InputError, match=r"the survey has no CRS: name it in survey\.crs"):
        read_checkpoints(path, None)


@pytest.mark.parametrize(
    ("content", "fault"),
    [
        (b"id,x,y\nA,1,2\n", "lacks the columns z"),
        (HEAD.encode(), "holds no checkpoints"),
        (b"id,x,y,z,surface\n\xff\xfe\x00,1,2,3,open\n", "no CSV of text in UTF-8"),
    ],
)
def test_a_file_that_is_none_is_refused(tmp_path: Path, content: bytes, fault: str) -> None:
    path = tmp_path / "c.csv"
    path.write_bytes(content)
    with pytest.raises(InputError, match=fault):
        read_checkpoints(path, UTM)
    with pytest.raises(InputError, match="no such file"):
        read_checkpoints(tmp_path / "none.csv", UTM)


@pytest.mark.parametrize("kind", ["MultiPoint Z", "MultiPoint"])
def test_a_row_without_a_point_or_with_several_leaves_out_itself(tmp_path: Path, kind: str) -> None:
    deep = kind.endswith("Z")
    positions = [(1, 2, 3), (11, 12, 13), (21, 22, 23)] if deep else [(1, 2), (11, 12), (21, 22)]
    shapes = [
        shapely.MultiPoint(positions[:1]),
        shapely.MultiPoint(positions[1:2]),
        None,
        shapely.MultiPoint(positions[1:]),
        shapely.MultiPoint(),
    ]
    fields = {"id": list("ABCDE"), "surface": ["open"] * 5, **({} if deep else {"z": [7.0] * 5})}
    pyogrio.raw.write(
        tmp_path / "c.gpkg",
        shapely.to_wkb(np.array(shapes, object)),
        [np.array(column, None if name == "z" else object) for name, column in fields.items()],
        list(fields),
        geometry_type=kind,
        crs="EPSG:32615",
    )
    found, remarks, _ = read_checkpoints(tmp_path / "c.gpkg", UTM, own=UTM)
    wanted = [("A", 1.0, 2.0, 3.0), ("B", 11.0, 12.0, 13.0)]
    assert [(one.id, one.x_m, one.y_m, one.z_m) for one in found] == [
        (name, x, y, z if deep else 7.0) for name, x, y, z in wanted
    ]
    assert remarks == [
        "3 checkpoints are left out, as there is no single point with finite x, y and z: C, D, E",
    ]
