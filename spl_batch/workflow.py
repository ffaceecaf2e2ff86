"""The workflow file: one model of every setting, from which ``schemas/`` is generated.

Each default is written here and nowhere else, each key has its unit in its name or in
its description, and an unknown key is an error that names the nearest known one. The model
here is that of an airborne survey; other receivers have their own (:mod:`spl_batch.receivers`).
"""

import difflib
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

import yaml
from pydantic import Field

from spl_batch.errors import WorkflowError
from spl_batch.receivers import HOMES, IMAGING, workflow_model
from spl_batch.sensor import Sensor, load_preset
from spl_batch.settings import (
    AcquisitionSettings,
    AfterpulseSettings,
    BaseWorkflow,
    FilterSettings,
    GroundSettings,
    NoiseSettings,
    OutputSettings,
    ProductSettings,
    ReferenceSettings,
    SurveySettings,
    TilingSettings,
    WireSettings,
)
from spl_batch.settings.faults import validated
from spl_batch.settings.mistaken import called, is_scene


class Workflow(BaseWorkflow):
    """Everything that a run on an airborne survey needs to know."""

    kind: Literal["imaging"] = Field("imaging", description="Airborne single-photon lidar.")
    survey: SurveySettings
    reference: ReferenceSettings | None = None
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

    def faults(self) -> Iterator[str]:
        """What is wrong that no single key shows."""
        try:
            dead_m = self.sensor.dead_m
        except WorkflowError as unknown_preset:
            yield str(unknown_preset)
        else:
            if self.afterpulse.enabled and self.afterpulse.lag_max_m <= dead_m:
                yield (
                    f"afterpulse.lag_max_m: {self.afterpulse.lag_max_m:g} m end within the "
                    f"sensor's dead time, {dead_m:.3f} m: no afterpulse would be found; "
                    f"write more, or afterpulse.enabled: false"
                )
        wires, given = self.filter.wires, WireSettings()
        # The default gives way to a smaller filter.alpha.
        if self._scans_lines and self.filter.alpha < wires.alpha != given.alpha:
            yield (
                f"filter.wires.alpha: {wires.alpha:g} exceeds filter.alpha, "
                f"{self.filter.alpha:g}, of which it is a part; lower it, or raise filter.alpha"
            )

    def remarks(self) -> Iterator[str]:
        """What has no effect with the filter that was chosen."""
        method = self.filter.method
        chosen = f"filter.method: {method}" + (
            f" with test: {self.filter.test}" if method == "vsaes" else ""
        )
        if self.filter.wires.classify and not self._scans_lines:
            off = "filter.wires.enabled: false" if not self.filter.wires.enabled else chosen
            yield f"filter.wires.classify: no point gets class 14, as {off} looks for no conductors"
        if self.outputs.diagnostics and method != "vsaes":
            yield f"outputs.diagnostics: p_value is NaN everywhere, as {chosen} knows none"

    @property
    def _scans_lines(self) -> bool:
        """Whether conductors are looked for."""
        own = self.filter.method == "vsaes" and self.filter.test != "published"
        return own and self.filter.wires.enabled


def parse_any(content: Mapping[str, Any], where: str) -> BaseWorkflow:
    """Check a workflow's content, whatever its receiver.

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
    model: type[BaseWorkflow] = workflow_model(known_kind(content, where))
    workflow = validated(model, content, where)
    faults = list(workflow.faults())
    if faults:
        raise WorkflowError(f"{where}: {'; '.join(faults)}")
    return workflow


def known_kind(content: Mapping[str, Any], where: str) -> str:
    """Receiver that a file is for, by its ``kind``; airborne surveys where it has none.

    Raises
    ------
    WorkflowError
        If there is no such receiver.
    """
    kind = content.get("kind", IMAGING)
    if kind not in HOMES:
        near = difflib.get_close_matches(str(kind), HOMES, n=1, cutoff=0.0)
        raise WorkflowError(f"{where}: kind: no receiver {kind!r}; the nearest is {near[0]!r}")
    return str(kind)


def parse_workflow(content: Mapping[str, Any], where: str) -> Workflow:
    """Check the content of an airborne survey's workflow; see :func:`parse_any`.

    Raises
    ------
    WorkflowError
        If it has a fault, or is for another receiver.
    """
    workflow = parse_any(content, where)
    if not isinstance(workflow, Workflow):
        raise WorkflowError(
            f"{where}: kind: {workflow.kind}; filters are compared on airborne surveys only "
            f"(kind: {IMAGING}); `spl-batch run` processes this one"
        )
    return workflow


def load_workflow(path: Path, overrides: Sequence[str] = ()) -> Workflow:
    """Read the workflow file of an airborne survey; see :func:`load_any`.

    Raises
    ------
    WorkflowError
        If the file has a fault, or is for another receiver.
    """
    return parse_workflow(_content(path, overrides), str(path))


def load_any(path: Path, overrides: Sequence[str] = ()) -> BaseWorkflow:
    """Read a workflow file, whatever its receiver.

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
    return parse_any(_content(path, overrides), str(path))


def _content(path: Path, overrides: Sequence[str]) -> dict[str, Any]:
    content = read_mapping(path, "a workflow is a mapping with survey: and output:")
    if is_scene(content):
        raise WorkflowError(
            f"{path}: this is a scene, not a workflow; `spl-batch simulate` takes it, and leaves a "
            "workflow.yaml that `spl-batch run` takes"
        )
    for override in overrides:
        _apply(content, override)
    return content


class _Loader(yaml.SafeLoader):
    """Safe loader that refuses a key given twice, of which YAML would keep the last."""

    def compose_mapping_node(self, anchor: Any) -> yaml.MappingNode:
        node = super().compose_mapping_node(anchor)
        lines: dict[str, int] = {}
        for key, _ in node.value:
            if not isinstance(key, yaml.ScalarNode):
                continue
            line = key.start_mark.line + 1
            first = lines.pop(key.value, None)
            if first is not None:
                raise yaml.MarkedYAMLError(
                    problem=f"key {key.value!r} stands twice, on lines {first} and {line}: keep one"
                )
            lines[key.value] = line
        return node


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
        If the file cannot be read, is not YAML, names a key twice, or holds no mapping.
    """
    what = called(path)
    if what:
        raise WorkflowError(f"{path}: {what}")
    try:
        content = _Loader(path.read_text(encoding="utf-8")).get_single_data()
    except OSError as error:
        raise WorkflowError(f"{path}: cannot be read: {error.strerror}") from None
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        reason = " ".join(str(error).split())
        if isinstance(error, yaml.MarkedYAMLError) and error.problem_mark is not None:
            reason = f"line {error.problem_mark.line + 1}: {error.problem}"
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
