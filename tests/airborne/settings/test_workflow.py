"""The workflow file: every fault in one line, the nearest key named, every key explained."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml
from pydantic import BaseModel

from spl_batch.airborne.sensors.sensor import Sensor, load_preset, preset_names
from spl_batch.airborne.settings.workflow import Workflow, load_workflow, parse_workflow
from spl_batch.engine.settings.workflow_file import load_any
from spl_batch.errors import WorkflowError

MINIMAL: dict[str, Any] = {"survey": {"flightlines": "*.laz"}, "output": "out"}

UNITS = (
    "_m",
    "_s",
    "_hz",
    "_deg",
    "_nm",
    "_uj",
    "_urad",
    "_ns",
    "_shots",
    "_intervals",
    "_tiles",
    "_ratio",
)
PURE_NUMBERS = {"alpha", "weak_alpha", "weight_min", "dsm_false_alarm", "neighbours"}
PURE_NUMBERS |= {"quantum_efficiency", "receiver_efficiency", "hologram_efficiency"}
PURE_NUMBERS |= {"afterpulse_probability", "vegetation_loss"}


def fields(model: type[BaseModel], prefix: str = "") -> Iterator[tuple[str, Any, type[BaseModel]]]:
    """Every key of a model and of the sections below it."""
    for name, info in model.model_fields.items():
        yield f"{prefix}{name}", info, model
        for part in (info.annotation, *getattr(info.annotation, "__args__", ())):
            if isinstance(part, type) and issubclass(part, BaseModel):
                yield from fields(part, f"{prefix}{name}.")


ALL_FIELDS = list(fields(Workflow))


def write(path: Path, content: Any) -> Path:
    text = content if isinstance(content, str) else yaml.safe_dump(content)
    path.write_text(text, encoding="utf-8")
    return path


def complaint(content: dict[str, Any], where: str = "w.yaml") -> str:
    with pytest.raises(WorkflowError) as caught:
        parse_workflow(content, where)
    message = str(caught.value)
    assert message.startswith(f"{where}: ")
    assert "\n" not in message
    return message


def merged(**sections: Any) -> dict[str, Any]:
    return {**MINIMAL, **sections}


@pytest.mark.parametrize(("key", "info", "model"), ALL_FIELDS, ids=[f[0] for f in ALL_FIELDS])
def test_every_key_is_explained_with_its_unit(key: str, info: Any, model: type[BaseModel]) -> None:
    parts = (info.annotation, *getattr(info.annotation, "__args__", ()))
    section = [p for p in parts if isinstance(p, type) and issubclass(p, BaseModel)]
    text = info.description or " ".join(p.__doc__ or "" for p in section)
    assert text.strip(), f"{model.__name__}.{key} says nothing about itself"
    name = key.rsplit(".", 1)[-1]
    if {int, float} & set(parts) and bool not in parts:
        assert name.endswith(UNITS) or "[" in text or name in PURE_NUMBERS, f"{key}: which unit?"


@pytest.mark.parametrize(
    ("content", "key"),
    [
        (MINIMAL, "noise.buffer_m"),
        ({"kind": "altimetry", "track": {"photons": "*.h5"}, "output": "out"}, "rate.cell_m"),
        (
            {
                "kind": "coincidence",
                "survey": {"frames": "f.parquet", "detections": "d.parquet"},
                "output": "out",
            },
            "array.gate_stop_m",
        ),
        (
            {"kind": "water_surface", "survey": {"frames": "*.h5"}, "output": "out"},
            "calibration.offset_ns",
        ),
    ],
)
def test_numbers_are_finite(tmp_path: Path, content: dict[str, Any], key: str) -> None:
    path = write(tmp_path / "w.yaml", content)
    with pytest.raises(WorkflowError, match=rf"{key}: .*finite number .found nan"):
        load_any(path, [f"{key}=.nan"])


@pytest.mark.parametrize(
    ("text", "length_m"),
    [
        ("50 ft", 15.24),
        ("50us-ft", 50 * 1200 / 3937),
        (" 15 m", 15.0),
        ("1.5e1", 15.0),
        ("50 ftUS", None),
        ("50 feet", None),
        ("ft", None),
    ],
)
def test_a_length_has_a_unit_that_is_known(text: str, length_m: float | None) -> None:
    content = merged(products={"edge_max_m": text})
    if length_m is None:
        said = complaint(content)
        assert "edge_max_m: write metres, or a length with its unit: 15 m, 50 ft" in said
        assert "50 us-ft" in said
    else:
        found = parse_workflow(content, "w").products.edge_max_m
        assert found == pytest.approx(length_m, abs=1e-12)
    plain = complaint(merged(products={"cell_m": text if length_m != 15.0 else "15 m"}))
    assert "products.cell_m: this key takes a number of metres, without a unit" in plain


FILES, KHZ = MINIMAL["survey"], "30 kHz is 30000"
FAULTS = [
    ({"tiling": {"tile": 1}}, ("tiling.tile: no such key", "'tiling.tile_m'")),
    ({"outputs": {"drop": "noise"}}, ("outputs.drop: write a list, [noise] (found 'noise')",)),
    (
        {"outputs": {"client_tiles": "t.gpkg"}},
        ("client_tiles: write a mapping with the keys polygons, name, format (found 't.gpkg')",),
    ),
    ({"reference": 3}, ("reference: write a mapping with the keys points, crs,", "(found 3)")),
    ({"filter": {"alhpa": 1}}, ("filter.alhpa: no such key", "'filter.alpha'")),
    (
        {"survey": FILES | {"flight_lines": 1}},
        ("survey.flight_lines: no such", "'survey.flightlines'"),
    ),
    ({"ground": {"methd": 1}}, ("ground.methd: no such key", "'ground.method'")),
    ({"acquisition": {"prf": 1}}, ("acquisition.prf: no such key", "'acquisition.prf_hz'")),
    ({"watr": "x"}, ("'water'",)),
    ({"filters": {}}, ("'filter'",)),
    ({"tile_m": 50}, ("'tiling.tile_m'",)),  # a key of another section
    ({"survey": FILES | {"sensor": {"name": "mine", "prf": 5}}}, ("'survey.sensor.prf_hz'",)),
    ({"survey": FILES | {"licence": "free for all"}}, ("survey.licence",)),
    ({"outputs": {"drop": ["water"]}}, ("outputs.drop",)),
    ({"outputs": {"contour_interval": 0}}, ("outputs.contour_interval",)),
    ({"outputs": {"client_tiles": {"name": "id"}}}, ("outputs.client_tiles.polygons",)),
    ({"products": {"cell_m": 0.3048}}, ("products.cell_m: not a whole", "outputs.cell (found 0")),
    ({"tiling": {"tile_m": 1e-4}}, ("tiling.tile_m: not a whole number of millimetres",)),
    ({"products": {"cell_m": 0.7}}, ("ground.cell_m (200) must be a whole multiple of", "(0.7)")),
    ({"acquisition": {"prf_hz": 30}}, ("acquisition.prf_hz: ", KHZ)),
    ({"acquisition": {"prf_hz": 3e7}}, ("acquisition.prf_hz: ", KHZ)),
    ({"survey": FILES | {"sensor": {"name": "mine", "prf_hz": 30}}}, ("survey.sensor: ", KHZ)),
    ({"survey": FILES | {"sensor": {"name": "mine", "prf_hz": 3e7}}}, ("survey.sensor: ", KHZ)),
]


@pytest.mark.parametrize(("change", "words"), FAULTS)
def test_a_wrong_key_or_value_is_named(change: dict[str, Any], words: tuple[str, ...]) -> None:
    message = complaint(merged(**change))
    for word in words:
        assert word in message
    assert "valid string" not in message, "a mapping is meant, not a name"


def test_every_fault_in_one_line() -> None:
    content = {
        "survey": {"flightlines": 7, "gap_s": -1},
        "tiling": {"tile_m": "wide"},
        "filter": {"method": "magic", "alpha": 2},
        "grund": {},
    }
    message = complaint(content)
    for part in (
        "survey.gap_s",
        "tiling.tile_m",
        "filter.method",
        "filter.alpha",
        "grund",
        "output",
    ):
        assert part in message, part
    for value in ("-1", "'wide'", "'magic'"):
        assert value in message, value


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ("survey: [", "not valid YAML"),
        ("just words", "is a mapping"),
        ("", "is a mapping"),
        ("[1, 2]", "is a mapping"),
        ("survey:\n\tflightlines: a", "not valid YAML"),
    ],
)
def test_files_that_are_no_workflow(tmp_path: Path, content: str, words: str) -> None:
    path = write(tmp_path / "w.yaml", content)
    with pytest.raises(WorkflowError, match=words) as caught:
        load_workflow(path)
    assert str(caught.value).startswith(str(path))
    assert "\n" not in str(caught.value)


def test_overrides_apply_in_order_and_parse_as_yaml(tmp_path: Path) -> None:
    path = write(tmp_path / "w.yaml", MINIMAL)
    workflow = load_workflow(
        path,
        [
            "tiling.tile_m=50",
            "tiling.tile_m=60",
            "afterpulse.enabled=false",
            "survey.trajectory=[a.csv, b.csv]",
            "aoi=null",
            "ground.ptd.object_m=40",
        ],
    )
    assert workflow.tiling.tile_m == 60.0
    assert workflow.afterpulse.enabled is False
    assert workflow.survey.trajectory == ("a.csv", "b.csv")
    assert workflow.ground.ptd.object_m == 40.0
    assert load_workflow(path).tiling.tile_m == 100.0


@pytest.mark.parametrize(
    ("override", "words"),
    [
        ("tiling.tile_m", "key.path=value"),
        ("=5", "key.path=value"),
        ("output.deep=5", "is a value, not a section"),
        ("tiling.tile_m=[", "not valid YAML"),
        ("tiling.tile=5", "'tiling.tile_m'"),
        ("tiling.tile_m=-5", "tiling.tile_m"),
    ],
)
def test_bad_overrides(tmp_path: Path, override: str, words: str) -> None:
    path = write(tmp_path / "w.yaml", MINIMAL)
    with pytest.raises(WorkflowError, match=words.replace(".", r"\.")):
        load_workflow(path, [override])


def test_sensors_by_name_and_by_mapping() -> None:
    assert "spl100" in preset_names()
    given = parse_workflow(merged(acquisition={"prf_hz": 25000, "gate_m": 90}), "w")
    assert (given.sensor.prf_hz, given.sensor.gate_m) == (25000.0, 90.0)
    own = {"name": "mine", "beamlets": 16, "prf_hz": 8000}
    workflow = parse_workflow(merged(survey={"flightlines": "a", "sensor": own}), "w")
    assert workflow.sensor == Sensor(**own)
    assert "known are" in _sensor_fault("spl99")
    with pytest.raises(WorkflowError, match="spl100"):
        load_preset("nothing")
    assert load_preset("SPL100") == load_preset("spl100")


def test_a_linear_mode_scanner_is_no_reason_to_filter_photons() -> None:
    survey = {"flightlines": "a", "sensor": "als50-ii"}
    assert "Leica ALS50-II counts no single photons" in complaint(merged(survey=survey))
    off = {"filter": {"method": "none"}, "afterpulse": {"enabled": False}}
    sensor = parse_workflow(merged(survey=survey, **off), "w").sensor
    assert (sensor.beamlets, sensor.range_sigma_m, sensor.wavelength_nm) == (1, 0.05, 1064.0)
    assert 2.69 < sensor.dead_m < 2.7


def test_faults_between_keys_come_all_at_once_with_the_file() -> None:
    content = merged(
        survey={"flightlines": "a", "sensor": {"dead_time_ns": 8.0}},
        afterpulse={"lag_max_m": 0.5},
        filter={"alpha": 0.001, "wires": {"alpha": 0.01}},
    )
    message = complaint(content)
    assert message.startswith("w.yaml: afterpulse.lag_max_m: 0.5 m end within")
    assert "dead time, 1.199 m" in message
    assert "filter.wires.alpha: 0.01 exceeds filter.alpha, 0.001" in message
    preset = complaint({**content, "survey": {"flightlines": "a", "sensor": "spl99"}})
    assert "w.yaml: survey.sensor: no preset 'spl99'" in preset
    assert "filter.wires.alpha" in preset


@pytest.mark.parametrize(
    "fine",
    [
        {"acquisition": {"prf_hz": 1000}},
        {"filter": {"alpha": 1e-4}},
        {"filter": {"wires": {"alpha": 0.01, "enabled": False}}},
        {"filter": {"method": "aes", "wires": {"alpha": 0.01}}},
        {"filter": {"test": "published", "wires": {"alpha": 0.01}}},
        {"afterpulse": {"enabled": False, "lag_max_m": 0.1}},
        {"afterpulse": {"method": "published", "lag_max_m": 0.1}},
    ],
)
def test_what_does_not_matter_is_no_fault(fine: dict[str, Any]) -> None:
    workflow = parse_workflow(merged(**fine), "w")
    kept = workflow.model_dump(mode="json")
    assert parse_workflow(kept, "w") == workflow, "as the store keeps it, with every key"


@pytest.mark.parametrize(
    ("filtering", "said"),
    [
        ({}, []),
        ({"method": "aes"}, ["class 14, as filter.method: aes looks", "as filter.method: aes"]),
        ({"test": "published"}, ["as filter.method: vsaes with test: published looks"]),
        ({"wires": {"enabled": False}}, ["as filter.wires.enabled: false looks"]),
    ],
)
def test_what_has_no_effect_is_said(filtering: dict[str, Any], said: list[str]) -> None:
    wires = {**filtering.get("wires", {}), "classify": True}
    content = merged(filter={**filtering, "wires": wires}, outputs={"diagnostics": True})
    remarks = list(parse_workflow(content, "w").remarks())
    assert len(remarks) == len(said)
    for words, remark in zip(said, remarks, strict=True):
        assert words in remark
    assert not list(parse_workflow(merged(filter=filtering), "w").remarks())


def test_a_clients_tiles_in_another_crs_are_no_effect_of_its_keys() -> None:
    def remarks(**outputs: Any) -> list[str]:
        return list(parse_workflow(merged(outputs=outputs), "w").remarks())

    tiles = {"client_tiles": {"polygons": "tiles.gpkg"}}
    (said,) = remarks(crs="EPSG:6344", cell=3, **tiles)
    assert "outputs.crs and outputs.cell: without effect on client_tiles" in said
    assert not remarks(units="us-ft", cell=3, **tiles)
    assert not remarks(crs="EPSG:6344", cell=3)


def _sensor_fault(name: str) -> str:
    with pytest.raises(WorkflowError) as caught:
        parse_workflow(merged(survey={"flightlines": "a", "sensor": name}), "w")
    return str(caught.value)


def test_a_receiver_that_is_not_there_is_named_with_the_nearest(tmp_path: Path) -> None:
    path = write(tmp_path / "w.yaml", {**MINIMAL, "kind": "imagin"})
    with pytest.raises(WorkflowError, match=r"w\.yaml: kind: no receiver 'imagin'.*'imaging'"):
        load_any(path)
    assert load_any(path, ["kind=imaging"]) == load_workflow(write(path, MINIMAL))


def test_a_key_given_twice_is_refused_with_its_lines(tmp_path: Path) -> None:
    path = tmp_path / "w.yaml"
    path.write_text("output: a\nsurvey:\n  flightlines: a\n  flightlines: b\n")
    with pytest.raises(WorkflowError, match="key 'flightlines' is given twice, on lines 3 and 4"):
        load_workflow(path)
