"""The committed schemas are those of the models, and describe what the loader accepts."""

import json
from functools import cache
from pathlib import Path
from typing import Any

import jsonschema
import pytest

from spl_batch.airborne.settings.workflow import parse_workflow
from spl_batch.engine.report import schema as module
from spl_batch.engine.report.schema import generated, main, schemas
from spl_batch.errors import WorkflowError

FOLDER = Path(__file__).parents[1] / "schemas"
NAMES = sorted(path.name for path in FOLDER.glob("*.json"))
MINIMAL = {"survey": {"flightlines": "*.laz"}, "output": "out"}


def test_the_committed_schemas_are_not_stale() -> None:
    made = generated(FOLDER.parent)
    assert [path for path, text in made.items() if path.read_text(encoding="utf-8") != text] == []
    assert sorted(path.name for path in made if path.parent == FOLDER) == NAMES


def committed(name: str) -> dict[str, Any]:
    """A schema; the first test compares it with the models."""
    schema: dict[str, Any] = json.loads((FOLDER / name).read_text(encoding="utf-8"))
    return schema


@pytest.mark.parametrize("name", NAMES)
def test_each_schema_is_a_schema(name: str) -> None:
    schema = committed(name)
    jsonschema.Draft202012Validator.check_schema(schema)
    assert schema["$schema"].endswith("2020-12/schema")


def _leaves(schema: dict[str, Any]) -> list[tuple[str, dict[str, Any]]]:
    sections = [schema, *schema.get("$defs", {}).values()]
    return [item for section in sections for item in section.get("properties", {}).items()]


@pytest.mark.parametrize("name", NAMES)
def test_each_field_is_described(name: str) -> None:
    for key, field in _leaves(committed(name)):
        is_section = "$ref" in json.dumps(field) or key == "schema_version"
        assert "description" in field or is_section, f"{name}: {key} has no description"


@pytest.mark.parametrize(
    ("change", "good"),
    [
        ({}, True),
        ({"filter": {"method": "none"}}, True),
        ({"filter": {"alpha": 1.5}}, False),
        ({"filter": {"alhpa": 0.1}}, False),
        ({"tiling": {"tile_m": 0}}, False),
        ({"output": None}, False),
    ],
)
def test_schema_and_loader_agree(change: dict[str, Any], good: bool) -> None:  # noqa: FBT001
    content = {**MINIMAL, **change}
    schema = committed("workflow.schema.json")
    assert jsonschema.Draft202012Validator(schema).is_valid(content) is good
    if good:
        parse_workflow(content, "test")
    else:
        with pytest.raises(WorkflowError):
            parse_workflow(content, "test")


def test_the_generator_writes_checks_and_repairs(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "schemas", cache(schemas))
    folder = tmp_path / "made"
    assert main([str(folder), "--check"]) == 1
    assert not folder.exists()
    assert main([str(folder)]) == 0
    assert main([str(folder), "--check"]) == 0
    (folder / "schemas/report.schema.json").write_text("{}", encoding="utf-8")
    capsys.readouterr()
    assert main([str(folder), "--check"]) == 1
    assert "report.schema.json: stale" in capsys.readouterr().err
    assert main([str(folder)]) == 0
    assert main([str(folder), "--check"]) == 0
