"""YAML of settings: no key twice."""

from typing import Any

import yaml


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
    """Value that a YAML text stands for.

    Raises
    ------
    yaml.YAMLError
        If it is none, or names a key twice.
    """
    try:
        return yaml.load(text, _Loader)  # noqa: S506 - a safe loader
    except (ValueError, RecursionError) as error:  # of a date that is none, or of sections too deep
        raise yaml.YAMLError(str(error)) from None
