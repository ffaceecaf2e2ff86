"""The receivers that there are workflows for, and where the parts of each lie.

A workflow's ``kind`` names its receiver. Its parts are loaded when they are asked for: who
processes an airborne survey needs nothing of the others.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, Final

from spl_batch.errors import needed

IMAGING: Final = "imaging"
"""Kind of a workflow that names none: airborne single-photon lidar."""


@dataclass(frozen=True, slots=True)
class Home:
    """Where the parts of a receiver lie, as ``module:name``."""

    #: Model of its workflow file, a :class:`~spl_batch.engine.settings.base.BaseWorkflow`.
    workflow: str
    steps: str  #: What its tasks do: a table of :class:`~spl_batch.engine.tasks.step.Step`.
    receiver: str  #: What the verbs need: a :class:`~spl_batch.engine.verbs.receiver.Receiver`.
    report: str  #: Model of its report.
    #: Writes that and its page, and returns the model: a function of finished tasks by step and
    #: name, the context, and :class:`~spl_batch.engine.report.run_record.RunFacts`.
    summarise: str
    #: Makes synthetic data: a function of a scene file, an output folder and, by name, of
    #: ``progress``, which takes the share that is done; what it gives back has ``rows``, label
    #: and value of what a user reads. It leaves a ``workflow.yaml`` in the folder.
    simulate: str
    compare: str = ""  #: Runs several methods side by side; empty where it has one.
    #: Writes a first workflow: a function of a folder that gives a
    #: :class:`~spl_batch.engine.verbs.beginning.Beginning`, or None where there is nothing for it;
    #: empty where no file shows that it is for this receiver. ``inputs`` names such files.
    begin: str = ""
    inputs: str = ""
    #: Extra of this project that installs what it needs beside an airborne survey.
    extra: str = "report"
    #: What its codes mean: a mapping of :class:`~spl_batch.engine.findings.Code`.
    codes: str = ""


HOMES: Final[Mapping[str, Home]] = MappingProxyType(
    {
        IMAGING: Home(
            "spl_batch.airborne.settings.workflow:Workflow",
            "spl_batch.airborne.steps:STEPS",
            "spl_batch.airborne.receiver:RECEIVER",
            "spl_batch.airborne.report.model:Report",
            "spl_batch.airborne.report.summarise:summarise",
            "spl_batch.airborne.simulate:simulate_file",
            "spl_batch.airborne.compare.comparison:METHODS",
            "spl_batch.airborne.first_use.commented:begin",
            "LAS, LAZ or COPC file",
            codes="spl_batch.airborne.findings:CODES",
        ),
        "altimetry": Home(
            "spl_batch.altimetry.settings:TrackWorkflow",
            "spl_batch.altimetry.steps:STEPS",
            "spl_batch.altimetry.receiver:RECEIVER",
            "spl_batch.altimetry.report.model:TrackReport",
            "spl_batch.altimetry.report.summarise:summarise",
            "spl_batch.altimetry.simulate:simulate_file",
            "spl_batch.altimetry.compare.comparison:METHODS",
            "spl_batch.altimetry.first_use:begin",
            "file of photons along a track (ATL03 or MABEL-like HDF5, CSV with the columns "
            "along_track and height)",
            extra="altimetry",
            codes="spl_batch.altimetry.findings:CODES",
        ),
        "coincidence": Home(
            "spl_batch.geiger.coincidence.settings:CoincidenceWorkflow",
            "spl_batch.geiger.coincidence.steps:STEPS",
            "spl_batch.geiger.coincidence.receiver:RECEIVER",
            "spl_batch.geiger.coincidence.report.model:CoincidenceReport",
            "spl_batch.geiger.coincidence.report.summarise:summarise",
            "spl_batch.geiger.coincidence.simulate:simulate_file",
            extra="geiger",
            codes="spl_batch.geiger.coincidence.findings:CODES",
        ),
        "water_surface": Home(
            "spl_batch.geiger.water.settings:WaterWorkflow",
            "spl_batch.geiger.water.steps:STEPS",
            "spl_batch.geiger.water.receiver:RECEIVER",
            "spl_batch.geiger.water.report.model:WaterReport",
            "spl_batch.geiger.water.report.summarise:summarise",
            "spl_batch.geiger.water.simulate:simulate_file",
            extra="geiger",
            codes="spl_batch.geiger.water.findings:CODES",
        ),
    }
)
"""Every receiver, by the kind of its workflows."""


def workflow_model(kind: str) -> Any:
    """Model of a receiver's workflow file."""
    return _part(kind, HOMES[kind].workflow)


def steps(kind: str) -> Any:
    """What a receiver's tasks do, by name of the step, in order."""
    return _part(kind, HOMES[kind].steps)


def receiver(kind: str) -> Any:
    """What the verbs need of a receiver."""
    return _part(kind, HOMES[kind].receiver)


def report_model(kind: str) -> Any:
    """Model of a receiver's report."""
    return _part(kind, HOMES[kind].report)


def summariser(kind: str) -> Any:
    """What writes a receiver's report; it takes seconds to import what draws."""
    return _part(kind, HOMES[kind].summarise)


def simulator(kind: str) -> Any:
    """What makes synthetic data for a receiver."""
    return _part(kind, HOMES[kind].simulate)


def comparison(kind: str) -> Any:
    """Methods of a receiver that can be compared; None where it has one."""
    place = HOMES[kind].compare
    return _part(kind, place) if place else None


def beginner(kind: str) -> Any:
    """What writes a first workflow for a receiver's files; None where nothing does."""
    place = HOMES[kind].begin
    return _part(kind, place) if place else None


def findings() -> Iterator[Any]:
    """What the codes of each receiver mean."""
    for home in HOMES.values():
        if home.codes:
            yield load(home.codes)


def _part(kind: str, place: str) -> Any:
    """Part of a receiver; one line where a package is missing that it needs."""
    return load(place, f"workflows of the kind {kind}", HOMES[kind].extra)


def load(place: str, what: str = "these tasks", extra: str = "report,altimetry,geiger") -> Any:
    """What lies at a place, ``module:name``; ``what`` needs it, and ``extra`` installs it."""
    module, _, name = place.partition(":")
    return getattr(needed(module, what, extra), name)
