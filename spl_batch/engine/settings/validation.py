"""Faults of a workflow or a scene: one line, every fault, the nearest known key."""

import difflib
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, TypeVar, get_args

from pydantic import BaseModel, ValidationError

from spl_batch.errors import WorkflowError, brief

M = TypeVar("M", bound=BaseModel)


def validated(model: type[M], content: Mapping[str, Any], where: str) -> M:
    """Content as a model.

    Raises
    ------
    WorkflowError
        One line that lists every fault.
    """
    try:
        return model.model_validate(content)
    except ValidationError as error:
        faults = (_fault(e, model) for e in error.errors(include_url=False))
        raise WorkflowError(f"{where}: {'; '.join(filter(None, faults))}") from None


def _fault(error: Any, model: type[BaseModel]) -> str:
    """A fault in words; empty for "no name", where a mapping may be given as well."""
    given = error.get("input")
    if isinstance(given, Mapping) and error["type"] == "string_type" and error["loc"][-1] == "str":
        return ""
    # pydantic names the member of a union on the way, as in survey.sensor.Sensor.prf.
    parts = [str(part) for part in error["loc"] if not str(part)[:1].isupper()]
    place = ".".join(parts[:-1] if parts[-1:] == ["str"] else parts)
    if error["type"] == "extra_forbidden":
        near = _nearest([part for part in parts if not part.isdigit()], [*_keys(model)])
        return f"{place}: no such key; the nearest known key is {near!r}"
    message = error["msg"].removeprefix("Value error, ")
    if error["type"] == "float_parsing" and place.endswith("_m"):
        message = "this key takes a number of metres, without a unit"
    shown = "" if isinstance(given, dict) else f" (found {brief(repr(given), 100)})"
    return f"{place}: {message[0].lower()}{message[1:]}{shown}" if place else message


def _nearest(names: Sequence[str], known: Sequence[tuple[str, ...]]) -> str:
    """Known key most like an unknown one, those of its own section first."""
    own = [key for key in known if key[:-1] == tuple(names[:-1])]
    for keys, cutoff in ((own, 0.6), (known, 0.0)):
        near = difflib.get_close_matches(names[-1], [key[-1] for key in keys], n=1, cutoff=cutoff)
        if near:
            return ".".join(next(key for key in keys if key[-1] == near[0]))
    return ""


def _keys(annotation: Any, above: tuple[str, ...] = ()) -> Iterator[tuple[str, ...]]:
    """Path of every key of a section and below it, also of members of unions and of tuples."""
    for part in get_args(annotation):
        yield from _keys(part, above)
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        for name, field in annotation.model_fields.items():
            yield (*above, name)
            yield from _keys(field.annotation, (*above, name))
