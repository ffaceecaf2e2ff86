"""Parameters of a run as a reader wants them: first those that are not the default."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Final

import yaml
from pydantic import BaseModel, ValidationError

from spl_batch.receivers import HOMES, IMAGING, workflow_model

LONGEST_VALUE: Final = 160
"""Longest value that the table of changed parameters shows whole [characters]."""


def changed(parameters: Mapping[str, Any]) -> Iterator[tuple[str, str]]:
    """Dotted key and value of what a workflow sets otherwise than the default does.

    ``parameters``: a whole workflow, defaults included, as ``provenance.parameters`` of a report.
    """
    kind = parameters.get("kind", IMAGING)
    try:
        workflow: BaseModel = workflow_model(kind if kind in HOMES else IMAGING)(**parameters)
    except ValidationError:  # of another version, whose keys are others
        return
    yield from _flat(workflow.model_dump(mode="json", exclude_defaults=True), "")


def _flat(given: Mapping[str, Any], before: str) -> Iterator[tuple[str, str]]:
    for name, value in given.items():
        if isinstance(value, Mapping) and value:
            yield from _flat(value, f"{before}{name}.")
        elif f"{before}{name}" != "kind":
            text = yaml.safe_dump(value, default_flow_style=True, width=10**6)
            shown = text.removesuffix("\n").removesuffix("\n...")
            cut = f"{shown[:LONGEST_VALUE]} ..." if len(shown) > LONGEST_VALUE else shown
            yield f"{before}{name}", cut


def without(parameters: Mapping[str, Any], keys: Sequence[str]) -> dict[str, Any]:
    """Parameters less some of their keys, dotted where they lie deeper."""
    kept = {}
    for name, value in parameters.items():
        deeper = [k.removeprefix(f"{name}.") for k in keys if k.startswith(f"{name}.")]
        if name not in keys:
            kept[name] = without(value, deeper) if deeper and isinstance(value, Mapping) else value
    return kept
