"""The workflow file: one model of every setting, from which ``schemas/`` is generated.

Each default is written here and nowhere else, each key has its unit in its name or in
its description, and an unknown key is an error that names the nearest known one. The model
here is that of an airborne survey; other receivers have their own (:mod:`spl_batch.receivers`).
"""

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

from pydantic import Field

from spl_batch.airborne.sensors.sensor import Sensor, load_preset
from spl_batch.airborne.settings import (
    AcquisitionSettings,
    AfterpulseSettings,
    ClassSettings,
    FilterSettings,
    GroundSettings,
    NoiseSettings,
    OutputSettings,
    ProductSettings,
    ReferenceSettings,
    RequirementSettings,
    SurveySettings,
    TilingSettings,
    WireSettings,
)
from spl_batch.engine.settings.base import BaseWorkflow
from spl_batch.engine.settings.workflow_file import parse_any, workflow_content
from spl_batch.errors import WorkflowError
from spl_batch.lattice.tiles import quanta
from spl_batch.receivers import IMAGING


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
    classes: ClassSettings = ClassSettings()
    outputs: OutputSettings = OutputSettings()
    requirements: RequirementSettings = RequirementSettings()
    water: str | None = Field(None, description="Polygons of water, any vector format.")
    breaklines: str | None = Field(
        None,
        description="Lakes and rivers with heights, in the survey's unit, that the terrain "
        "model is flattened by: polygons and, in rivers, lines, any vector format.",
    )
    aoi: str | None = Field(None, description="Polygons of the area of interest.")

    @property
    def sensor(self) -> Sensor:
        """The instrument, with the acquisition's own PRF and gate put in."""
        chosen = self.survey.sensor
        sensor = load_preset(chosen) if isinstance(chosen, str) else chosen
        given = self.acquisition.model_dump(exclude_none=True)
        return sensor.model_copy(update=given)

    @property
    def filtering(self) -> bool:
        """Whether noise or afterpulses are looked for, which needs shots and times."""
        return self.filter.method != "none" or self.afterpulse.enabled

    def faults(self) -> Iterator[str]:
        """What is wrong that no single key shows."""
        try:
            sensor = self.sensor
        except WorkflowError as unknown_preset:
            yield str(unknown_preset)
        else:
            if self.filtering and not sensor.photons:
                yield (
                    f"survey.sensor: {sensor.name} counts no single photons, so true points would "
                    "be taken for noise; set filter.method: none and afterpulse.enabled: false"
                )
            dead_m = sensor.dead_m
            lags = self.afterpulse.enabled and self.afterpulse.method == "beamlet"
            if lags and self.afterpulse.lag_max_m <= dead_m:
                yield (
                    f"afterpulse.lag_max_m: {self.afterpulse.lag_max_m:g} m end within the "
                    f"sensor's dead time, {dead_m:.3f} m: no afterpulse would be found; "
                    f"write more, or afterpulse.enabled: false"
                )
        if quanta(self.ground.cell_m) % quanta(self.products.cell_m):
            yield (
                f"ground.cell_m ({self.ground.cell_m:g}) must be a whole multiple of "
                f"products.cell_m ({self.products.cell_m:g})"
            )
        wires, given = self.filter.wires, WireSettings()
        # The default gives way to a smaller filter.alpha.
        if self._scans_lines and self.filter.alpha < wires.alpha != given.alpha:
            yield (
                f"filter.wires.alpha: {wires.alpha:g} exceeds filter.alpha, "
                f"{self.filter.alpha:g}, of which it is a part; lower it, or raise filter.alpha"
            )

    def remarks(self) -> Iterator[str]:
        """What has no effect, or an unexpected one, beside other settings."""
        method = self.filter.method
        chosen = f"filter.method: {method}" + (
            f" with test: {self.filter.test}" if method == "vsaes" else ""
        )
        if self.filter.wires.classify and not self._scans_lines:
            off = "filter.wires.enabled: false" if not self.filter.wires.enabled else chosen
            yield f"filter.wires.classify: no point gets class 14, as {off} looks for no conductors"
        asked = [name for name in ("building", "vegetation") if getattr(self.classes, name)]
        if asked and self.outputs.classes == "noise":
            names = " and ".join(f"classes.{name}" for name in asked)
            yield (
                f"{names}: without effect, as outputs.classes: noise lets signal points keep "
                "the class of the input; write outputs.classes: all"
            )
        elif asked == ["vegetation"]:
            yield (
                "classes.vegetation: roofs become high vegetation where the input has no class 6; "
                "write classes.building: true"
            )
        if "outside" in self.outputs.drop and self.aoi is None:
            yield "outputs.drop: outside is without effect, as no aoi is named"
        yield from self.outputs.remarks()
        if self.outputs.diagnostics and method != "vsaes":
            yield f"outputs.diagnostics: p_value is NaN everywhere, as {chosen} knows none"

    @property
    def _scans_lines(self) -> bool:
        """Whether conductors are looked for."""
        own = self.filter.method == "vsaes" and self.filter.test != "published"
        return own and self.filter.wires.enabled


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
    """Read the workflow file of an airborne survey; see :func:`.load_any`.

    Raises
    ------
    WorkflowError
        If the file has a fault, or is for another receiver.
    """
    return parse_workflow(workflow_content(path, overrides), str(path))
