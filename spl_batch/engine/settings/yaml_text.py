"""YAML of settings: no key twice, and nothing that grows as it is read.

Aliases could make gigabytes of a few lines, and deep nesting stops a parser: neither is taken.
Texts are such as files can be called and hold: UTF-8 without NUL.
"""

import re
from typing import Any, Final

import yaml

TEXT_MAX: Final = 1 << 20
"""Characters of a file [count]."""

NODES_MAX: Final = 50_000
"""Values of a file, those behind references counted each time [count]."""

DIGITS_MAX: Final = 300
"""Characters of a whole number, as many as the largest floating-point one has [count]."""

DEPTH_MAX: Final = 40
"""Sections within each other [count]."""


_PAIR: Final = re.compile("[\ud800-\udbff][\udc00-\udfff]")
_NO_TEXT: Final = re.compile("[\0\ud800-\udfff]")


class NoTextError(yaml.MarkedYAMLError):
    """A text that no file can hold, or none can be called."""


class _Loader(yaml.SafeLoader):
    """Safe loader that refuses what no settings hold, and a key given twice."""

    def __init__(self, text: str) -> None:
        super().__init__(text)
        self._size: dict[int, tuple[int, int]] = {}
        self._open = 0

    def compose_node(self, parent: Any, index: Any) -> Any:
        if self.check_event(yaml.AliasEvent):
            node = super().compose_node(parent, index)
            if id(node) not in self._size:
                raise self._refused("refers to itself", node)
            return node
        self._open += 1
        if self._open > DEPTH_MAX:
            raise self._refused(f"is nested more than {DEPTH_MAX} deep", self.peek_event())  # type: ignore[no-untyped-call]
        node = super().compose_node(parent, index)
        self._open -= 1
        if isinstance(node, yaml.ScalarNode):
            key = f"{index.value}: " if isinstance(index, yaml.ScalarNode) else ""
            node.value = _whole_text(node, key)
        if node is not None and id(node) not in self._size:
            count, depth = self._measured(node)
            if count > NODES_MAX or depth > DEPTH_MAX:
                raise self._refused(
                    f"its references stand for {count} values, {depth} deep; at most {NODES_MAX} "
                    f"and {DEPTH_MAX} are read",
                    node,
                )
            self._size[id(node)] = count, depth
        return node

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
                    problem=f"key {key.value!r} stands twice, on lines {first} and {line}: keep one"
                )
            lines[key.value] = line
        return node

    def construct_yaml_int(self, node: yaml.ScalarNode) -> int:
        if len(node.value) > DIGITS_MAX:
            raise self._refused(f"a number of {len(node.value)} digits: no setting has one", node)
        return int(super().construct_yaml_int(node))

    def _measured(self, node: Any) -> tuple[int, int]:
        """Values that a node stands for, and how deep they are; those in it are known."""
        if isinstance(node, yaml.ScalarNode):
            return 1, 1
        pairs = isinstance(node, yaml.MappingNode)
        parts = [part for pair in node.value for part in pair] if pairs else node.value
        sizes = [self._size[id(part)] for part in parts]
        return 1 + sum(n for n, _ in sizes), 1 + max((d for _, d in sizes), default=0)

    @staticmethod
    def _refused(problem: str, place: Any) -> yaml.MarkedYAMLError:
        return yaml.MarkedYAMLError(problem=problem, problem_mark=place.start_mark)


_Loader.add_constructor("tag:yaml.org,2002:int", _Loader.construct_yaml_int)


def _whole_text(node: yaml.ScalarNode, key: str) -> str:
    """Text of a node; characters that JSON writes in two halves are put together.

    Raises
    ------
    NoTextError
        If it holds half a character, or NUL.
    """
    text = _PAIR.sub(_joined, node.value)
    wrong = _NO_TEXT.search(text)
    if wrong is None:
        return text
    if wrong[0] == "\0":
        what = "a NUL character (\\0): leave it out"
    else:
        what = f"half a character ({ascii(wrong[0])[1:-1]}): write the whole one"
    raise NoTextError(problem=f"{key}{text[:80]!a} has {what}", problem_mark=node.start_mark)


def _joined(pair: re.Match[str]) -> str:
    return pair[0].encode("utf-16-le", "surrogatepass").decode("utf-16-le")


def parse_yaml(text: str) -> Any:
    """Value that a YAML text stands for.

    Raises
    ------
    yaml.YAMLError
        If it is none, names a key twice, is larger or deeper than settings are, or has a text that
        no file can hold.
    """
    if len(text) > TEXT_MAX:
        raise yaml.YAMLError(f"it has {len(text)} characters; at most {TEXT_MAX} are read")
    try:
        return _Loader(text).get_single_data()
    except (ValueError, OverflowError) as error:  # of a date or a number that is none
        raise yaml.YAMLError(str(error)) from None
