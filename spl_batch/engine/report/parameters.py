"""Parameters of a run as a reader wants them: first those that are not the default."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Final, get_args

from pydantic import BaseModel
from pydantic.fields import FieldInfo

from spl_batch.engine.report.parts import finite_or_none
from spl_batch.receivers import HOMES, IMAGING, workflow_model

LONGEST_VALUE: Final = 160
"""Longest value that the table of changed parameters shows whole [characters]."""


def changed(parameters: Mapping[str, Any]) -> Iterator[tuple[str, str, str]]:
    """What a workflow sets otherwise than the default does.

    Parameters
    ----------
    parameters : mapping
        A whole workflow, defaults included, as ``provenance.parameters`` of a report.

    Yields
    ------
    (str, str, str)
        Dotted key, value, and default in words; a key that has none is ``required``.
    """
    kind = parameters.get("kind", IMAGING)
    if kind in HOMES:
        yield from _differing(workflow_model(kind), parameters, "")


def _differing(
    model: type[BaseModel], given: Mapping[str, Any], before: str
) -> Iterator[tuple[str, str, str]]:
    for name, value in given.items():
        field = model.model_fields.get(name)
        if field is None or (name == "kind" and not before):
            continue
        inner = _inner(field)
        if inner is not None and isinstance(value, Mapping):
            yield from _differing(inner, value, f"{before}{name}.")
        elif field.is_required():
            yield f"{before}{name}", _short(value), "required"
        elif value != (default := _default(field)):
            yield f"{before}{name}", _short(value), _short(default)


def _inner(field: FieldInfo) -> type[BaseModel] | None:
    """Model of a key that holds keys of its own; None where it may be one of several."""
    kinds = (field.annotation, *get_args(field.annotation))
    found = [k for k in kinds if isinstance(k, type) and issubclass(k, BaseModel)]
    return found[0] if len(found) == 1 else None


def _default(field: FieldInfo) -> Any:
    """Default of a key, in the form that a report holds it."""
    value = field.get_default(call_default_factory=True, validated_data={})
    if isinstance(value, BaseModel):
        value = value.model_dump(mode="json")
    return finite_or_none(value)


def _short(value: Any) -> str:
    """A value in words, cut where a table has no room: the whole is in the appendix."""
    said = _said(value)
    return said if len(said) <= LONGEST_VALUE else f"{said[:LONGEST_VALUE]} ..."


def _said(value: Any) -> str:
    """A value as YAML has it, without the types."""
    if value is None:
        return "none"
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, Mapping):
        return ", ".join(f"{key}: {_said(item)}" for key, item in value.items())
    if isinstance(value, Sequence) and not isinstance(value, str):
        return "[" + ", ".join(map(_said, value)) + "]"
    return f"{value:.12g}" if isinstance(value, float) else str(value)


def without(parameters: Mapping[str, Any], keys: Sequence[str]) -> dict[str, Any]:
    """Parameters less some of their keys, dotted where they lie deeper."""
    kept = {}
    for name, value in parameters.items():
        deeper = [k.removeprefix(f"{name}.") for k in keys if k.startswith(f"{name}.")]
        if name not in keys:
            kept[name] = without(value, deeper) if deeper and isinstance(value, Mapping) else value
    return kept
