"""YAML of settings: no key twice, and no text that a file can neither hold nor be called."""

from typing import Any

import yaml


class NoTextError(yaml.MarkedYAMLError):
    """A text that no file can hold, or none can be called."""


class _Loader(yaml.SafeLoader):
    """Safe loader that refuses a key given twice, and texts that are not UTF-8 without NUL."""

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
                    problem=f"key {key.value!r} is given twice, on lines {first} and {line}: keep"
                    " one"
                )
            lines[key.value] = line
        return node

    def construct_scalar(self, node: Any) -> Any:
        # JSON writes characters beyond the first 65 536 in two halves.
        text = str(super().construct_scalar(node)).encode("utf-16", "surrogatepass")
        try:
            whole = text.decode("utf-16")
        except UnicodeDecodeError:
            whole = "\0"
        if "\0" in whole:
            problem = f"{node.value[:80]!a} has a NUL character or half a character: leave it out"
            raise NoTextError(problem=problem, problem_mark=node.start_mark)
        return whole


def parse_yaml(text: str) -> Any:
    """Value that a YAML text stands for.

    Raises
    ------
    yaml.YAMLError
        If it is none, names a key twice, or has a text that no file can hold.
    """
    try:
        return yaml.load(text, _Loader)  # noqa: S506 - a safe loader
    except (ValueError, OverflowError) as error:  # of a date or a number that is none
        raise yaml.YAMLError(str(error)) from None
    except RecursionError:
        raise yaml.YAMLError("its sections are nested too deep") from None
