"""Workflow files of any receiver: read, overridden, checked against the receiver's model.

A file that has faults is refused in one line: every fault, and the nearest known key.
"""

import difflib
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, TypeVar, get_args

import yaml
from pydantic import BaseModel, ValidationError

from spl_batch.engine.settings.base import BaseWorkflow
from spl_batch.engine.settings.mistaken_file import refuse_urls
from spl_batch.errors import WorkflowError, named, reason_of, shortened
from spl_batch.receivers import HOMES, IMAGING, workflow_model

M = TypeVar("M", bound=BaseModel)


def parse_any(content: Mapping[str, Any], where: str) -> BaseWorkflow:
    """Check a workflow's content, whatever its receiver.

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
    """Receiver that a file is for, by its ``kind``; airborne surveys where it has none."""
    kind = content.get("kind", IMAGING)
    if kind not in HOMES:
        near = difflib.get_close_matches(str(kind), HOMES, n=1, cutoff=0.0)
        raise WorkflowError(f"{where}: kind: no receiver {kind!r}; the nearest is {near[0]!r}")
    return str(kind)


def load_any(path: Path, overrides: Sequence[str] = ()) -> BaseWorkflow:
    """Read a workflow file, whatever its receiver.

    ``overrides``: ``key.path=value``, value parsed as YAML; applied in order.

    Raises
    ------
    WorkflowError
        If the file cannot be read, is not YAML, or has a fault.
    """
    content = workflow_content(path, overrides)
    hint = "" if "output" in content else " (no workflow: `spl-batch simulate` takes scenes)"
    return parse_any(content, f"{path}{hint}")


def workflow_content(path: Path, overrides: Sequence[str]) -> dict[str, Any]:
    """Content of a workflow file, with ``key.path=value`` applied in order."""
    content = read_mapping(path, "a workflow is a mapping with survey: and output:")
    for override in overrides:
        _apply(content, override)
    return content


def read_mapping(path: Path, otherwise: str) -> dict[str, Any]:
    """Content of a YAML file that holds a mapping; ``otherwise``: the fault of another one.

    WorkflowError if it cannot be read, is not YAML, names a key twice, or holds no mapping.
    """
    refuse_urls(path)
    try:
        content = parse_yaml(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise WorkflowError(f"{path}: cannot be read: {reason_of(error)}") from None
    except UnicodeDecodeError:
        raise WorkflowError(f"{path}: this is a binary file; name it in a workflow") from None
    except yaml.YAMLError as error:
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
        node[parent] = {} if node.get(parent) is None else node[parent]
        node = node[parent]
        if not isinstance(node, dict):
            raise WorkflowError(f"--set {override}: {parent} is a value, not a section")
    try:
        node[last] = parse_yaml(text)
    except yaml.YAMLError:
        raise WorkflowError(
            f"--set {override}: the value is not valid YAML; quote it: key='*.laz'"
        ) from None


class _Loader(yaml.SafeLoader):
    """Safe loader that refuses a key given twice."""

    def compose_mapping_node(self, anchor: Any) -> yaml.MappingNode:
        node = super().compose_mapping_node(anchor)
        lines: dict[str, int] = {}
        for key, _ in node.value:
            line = key.start_mark.line + 1
            if isinstance(key, yaml.ScalarNode) and key.value in lines:
                raise yaml.MarkedYAMLError(
                    problem=f"key {key.value!r} is given twice, on lines {lines[key.value]} and "
                    f"{line}: keep one"
                )
            if isinstance(key, yaml.ScalarNode):
                lines[key.value] = line
        return node


def parse_yaml(text: str) -> Any:
    """Value of a YAML text; yaml.YAMLError where it is none, or names a key twice."""
    try:
        return yaml.load(text, _Loader)  # noqa: S506 - a safe loader
    except (ValueError, RecursionError) as error:  # of a date that is none, or of sections too deep
        raise yaml.YAMLError(str(error)) from None


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
    loc = map(str, error["loc"])
    parts = [part for part in loc if not (part[:1].isupper() or part.startswith("tuple["))]
    key = ".".join(parts[:-1] if parts[-1:] == ["str"] else parts)
    if error["type"] == "extra_forbidden":
        near = _nearest([part for part in parts if not part.isdigit()], [*_keys(model)])
        return f"{key}: no such key; the nearest known key is {near!r}"
    message = error["msg"].removeprefix("Value error, ")
    if error["type"] == "float_parsing" and key.endswith("_m"):
        message = "this key takes a number of metres, without a unit"
    elif error["type"] == "tuple_type":
        message = "write a list" + (
            f", [{shortened(given, 100)}]" if isinstance(given, str) else ""
        )
    elif error["type"] == "model_type":
        names = [name[-1] for name in _keys(model) if name[:-1] == tuple(parts)]
        message = f"write a mapping with the keys {named(list(dict.fromkeys(names)))}"
    shown = "" if isinstance(given, dict) else f" (found {shortened(repr(given), 100)})"
    return f"{key}: {message[0].lower()}{message[1:]}{shown}" if key else message


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
