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
        found = [e for e in error.errors(include_url=False) if not _of_another_member(e)]
        faults = "; ".join(_fault(e, model) for e in found)
        raise WorkflowError(f"{where}: {faults}") from None


def _of_another_member(error: Any) -> bool:
    """Whether an error only says that a mapping is no name, where either may stand."""
    given = isinstance(error.get("input"), Mapping)
    return given and error["type"] == "string_type" and error["loc"][-1] == "str"


def _fault(error: Any, model: type[BaseModel]) -> str:
    # pydantic names the member of a union on the way, as in survey.sensor.Sensor.prf.
    parts = [str(part) for part in error["loc"] if not str(part)[:1].isupper()]
    place = ".".join(parts[:-1] if parts[-1:] == ["str"] else parts)
    if error["type"] == "extra_forbidden":
        near = _nearest(parts, model)
        return f"{place}: no such key; the nearest known key is {near!r}"
    message = error["msg"].removeprefix("Value error, ")
    given = error.get("input")
    shown = "" if isinstance(given, dict) else f" (found {brief(repr(given), 100)})"
    return f"{place}: {message[0].lower()}{message[1:]}{shown}" if place else message


def _nearest(place: Sequence[str], model: type[BaseModel]) -> str:
    """Known key most like an unknown one, those of its own section first."""
    known = list(_keys(model))
    names = [part for part in place if not part.isdigit()]
    own = [key for key in known if key[:-1] == tuple(names[:-1])]
    for keys, cutoff in ((own, 0.6), (known, 0.0)):
        near = difflib.get_close_matches(names[-1], [key[-1] for key in keys], n=1, cutoff=cutoff)
        if near:
            return ".".join(next(key for key in keys if key[-1] == near[0]))
    return ""


def _keys(model: type[BaseModel], above: tuple[str, ...] = ()) -> Iterator[tuple[str, ...]]:
    """Path of every key of a section and of those below it."""
    for name, field in model.model_fields.items():
        yield (*above, name)
        for part in _parts(field.annotation):
            if isinstance(part, type) and issubclass(part, BaseModel):
                yield from _keys(part, (*above, name))


def _parts(annotation: Any) -> Iterator[Any]:
    """Types that an annotation is made of: members of unions, elements of tuples."""
    yield annotation
    for part in get_args(annotation):
        yield from _parts(part)
