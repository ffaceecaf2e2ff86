"""The workflow file: one model of every setting, from which ``schemas/`` is generated.

Each default is written here and nowhere else, each key has its unit in its name or in
its description, and an unknown key is an error that names the nearest known one.
"""

import difflib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, get_args

import yaml
from pydantic import BaseModel, Field, ValidationError

from spl_batch.errors import WorkflowError
from spl_batch.sensor import Sensor, load_preset
from spl_batch.settings import (
    AcquisitionSettings,
    AfterpulseSettings,
    FilterSettings,
    GroundSettings,
    NoiseSettings,
    OutputSettings,
    ProductSettings,
    ReferenceSettings,
    Section,
    SurveySettings,
    TilingSettings,
)


class Workflow(Section):
    """Everything that a run needs to know."""

    survey: SurveySettings
    reference: ReferenceSettings | None = None
    output: str = Field(description="Folder of the results, relative to this file.")
    tiling: TilingSettings = TilingSettings()
    acquisition: AcquisitionSettings = AcquisitionSettings()
    noise: NoiseSettings = NoiseSettings()
    filter: FilterSettings = FilterSettings()
    afterpulse: AfterpulseSettings = AfterpulseSettings()
    ground: GroundSettings = GroundSettings()
    products: ProductSettings = ProductSettings()
    outputs: OutputSettings = OutputSettings()
    water: str | None = Field(None, description="Polygons of water, any vector format.")
    aoi: str | None = Field(None, description="Polygons of the area of interest.")

    @property
    def sensor(self) -> Sensor:
        """The instrument, with the acquisition's own PRF and gate put in."""
        chosen = self.survey.sensor
        sensor = load_preset(chosen) if isinstance(chosen, str) else chosen
        given = self.acquisition.model_dump(exclude_none=True)
        return sensor.model_copy(update=given)


def parse_workflow(content: Mapping[str, Any], where: str) -> Workflow:
    """Check a workflow's content.

    Parameters
    ----------
    content : mapping
        Parsed YAML.
    where : str
        What messages call it: the file's path.

    Raises
    ------
    WorkflowError
        One line that lists every fault.
    """
    try:
        workflow = Workflow.model_validate(content)
    except ValidationError as error:
        faults = "; ".join(_fault(e) for e in error.errors(include_url=False))
        raise WorkflowError(f"{where}: {faults}") from None
    workflow.sensor  # noqa: B018 - an unknown preset is a fault of the file, found here
    return workflow


def load_workflow(path: Path, overrides: Sequence[str] = ()) -> Workflow:
    """Read a workflow file.

    Parameters
    ----------
    path : Path
        YAML file.
    overrides : sequence of str
        ``key.path=value``, value parsed as YAML; applied in order.

    Raises
    ------
    WorkflowError
        If the file cannot be read, is not YAML, or has a fault.
    """
    content = read_mapping(path, "a workflow is a mapping with survey: and output:")
    for override in overrides:
        _apply(content, override)
    return parse_workflow(content, str(path))


def read_mapping(path: Path, otherwise: str) -> dict[str, Any]:
    """Content of a YAML file that holds a mapping.

    Parameters
    ----------
    path : Path
        YAML file.
    otherwise : str
        What is said when it holds something else.

    Raises
    ------
    WorkflowError
        If the file cannot be read, is not YAML, or holds no mapping.
    """
    try:
        content = yaml.safe_load(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise WorkflowError(f"{path}: cannot be read: {error.strerror}") from None
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        reason = " ".join(str(error).split())
        raise WorkflowError(f"{path}: not valid YAML: {reason}") from None
    if not isinstance(content, dict):
        raise WorkflowError(f"{path}: {otherwise}")
    return content


def _apply(content: dict[str, Any], override: str) -> None:
    key, equals, text = override.partition("=")
    if not equals or not key:
        raise WorkflowError(f"--set {override}: write key.path=value")
    *parents, last = key.split(".")
    node = content
    for parent in parents:
        if node.get(parent) is None:
            node[parent] = {}
        child = node[parent]
        if not isinstance(child, dict):
            raise WorkflowError(f"--set {override}: {parent} is a value, not a section")
        node = child
    try:
        node[last] = yaml.safe_load(text)
    except yaml.YAMLError:
        raise WorkflowError(
            f"--set {override}: the value is not valid YAML; quote it: key='*.laz'"
        ) from None


def _fault(error: Any) -> str:
    place = ".".join(str(part) for part in error["loc"])
    if error["type"] == "extra_forbidden":
        # pydantic names the member of a union on the way, as in survey.sensor.Sensor.prf.
        near = _nearest([str(p) for p in error["loc"] if p != "Sensor"])
        return f"{place}: no such key; the nearest known key is {near!r}"
    given = error.get("input")
    shown = "" if isinstance(given, dict) else f" (found {given!r})"
    return f"{place}: {error['msg'][0].lower()}{error['msg'][1:]}{shown}"


def _nearest(place: Sequence[str]) -> str:
    """Known key most like an unknown one, those of its own section first."""
    known = _keys(Workflow)
    own = [key for key in known if key[:-1] == tuple(place[:-1])]
    for keys, cutoff in ((own, 0.6), (known, 0.0)):
        near = difflib.get_close_matches(place[-1], [key[-1] for key in keys], n=1, cutoff=cutoff)
        if near:
            return ".".join(next(key for key in keys if key[-1] == near[0]))
    return ""


def _keys(model: type[BaseModel], above: tuple[str, ...] = ()) -> list[tuple[str, ...]]:
    """Path of every key of a section and of those below it."""
    found: list[tuple[str, ...]] = []
    for name, field in model.model_fields.items():
        found.append((*above, name))
        for part in (field.annotation, *get_args(field.annotation)):
            if isinstance(part, type) and issubclass(part, BaseModel):
                found += _keys(part, (*above, name))
    return found
