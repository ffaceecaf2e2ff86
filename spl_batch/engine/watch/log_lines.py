"""Lines of ``log.jsonl`` as events again: one whose values cannot be is none."""

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import MISSING, Field, fields
from datetime import datetime
from functools import cache
from typing import Any, Final, get_args, get_type_hints

from pydantic import ConfigDict, TypeAdapter, ValidationError

from spl_batch.engine.watch.events import Event

MOST: Final = 1e18
"""No count, duration or memory of a run is larger."""

_EVENTS: Final = {event.__name__: event for event in get_args(Event)}


def event_of(line: bytes) -> dict[str, Any]:
    """An event as :func:`~spl_batch.engine.watch.events.as_record` gave it, with all its fields.

    Raises
    ------
    ValueError
        If the line is cut off, damaged, or has a value that no run writes.
    """
    try:
        record = json.loads(line)
        told = {"time": record["time"], "event": record["event"]}
        seconds(told)
        return told | {
            field.name: _checked(record, field, kind) for field, kind in _fields(told["event"])
        }
    except (KeyError, TypeError, RecursionError, OverflowError) as error:
        raise ValueError(f"no line of a log: {error}") from None


def seconds(record: Mapping[str, Any]) -> float:
    """When an event was logged [s since 1970]."""
    return datetime.fromisoformat(record["time"]).timestamp()


@cache
def _fields(event: str) -> list[tuple[Field[Any], Any]]:
    """Fields of an event, and their types."""
    kinds = get_type_hints(_EVENTS[event])
    return [(field, kinds[field.name]) for field in fields(_EVENTS[event])]


@cache
def _adapter(kind: Any) -> TypeAdapter[Any]:
    return TypeAdapter(kind, config=ConfigDict(strict=True, allow_inf_nan=False))


def _checked(record: Mapping[str, Any], field: Field[Any], kind: Any) -> Any:
    """The value of a field, of its type and within what can be; what is empty is left out."""
    name = field.name
    if name not in record and field.default is not MISSING:
        return field.default
    if name not in record and field.default_factory is not MISSING:
        return field.default_factory()
    value = record[name]
    try:
        _adapter(kind).validate_python(value)
    except ValidationError:
        raise ValueError(f"{name} is of another type") from None
    if not _within(value):
        raise ValueError(f"{name} is beyond {MOST:.0e}")
    if isinstance(value, int | float) and value < 0:
        raise ValueError(f"{name} is negative")
    return value


def _within(value: Any) -> bool:
    """Whether all numbers in a value are finite and of a size that a run can have."""
    if isinstance(value, Mapping):
        return all(map(_within, value.values()))
    if isinstance(value, Sequence) and not isinstance(value, str):
        return all(map(_within, value))
    return not isinstance(value, int | float) or (math.isfinite(value) and abs(value) <= MOST)
