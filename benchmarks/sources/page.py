"""The page of the sources: figures put into the template ``page.md``, and their files."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Final, NamedTuple

TEMPLATE: Final = Path(__file__).with_name("page.md")
FIGURES: Final = Path(__file__).parents[1] / "sources.json"
PAGE: Final = Path(__file__).parents[2] / "docs" / "sources.md"


class Group(NamedTuple):
    """Figures of a group by key, and the commit that measured them."""

    commit: str
    figures: Mapping[str, float]


def load() -> dict[str, Group]:
    """Groups that were measured last."""
    content = json.loads(FIGURES.read_text(encoding="utf-8")) if FIGURES.exists() else {}
    return {name: Group(**group) for name, group in content.items()}


def save(known: Mapping[str, Group]) -> None:
    """Write figures and page."""
    content = {name: known[name]._asdict() for name in sorted(known)}
    FIGURES.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")
    PAGE.write_text(text(known), encoding="utf-8")


def text(known: Mapping[str, Group]) -> str:
    """The page; a figure that was not measured is a dash."""
    figures = _Groups({name: _Figures(group.figures) for name, group in known.items()})
    commits = ", ".join(f"{name} `{group.commit}`" for name, group in sorted(known.items()))
    figures["commits"] = commits
    return TEMPLATE.read_text(encoding="utf-8").format_map(figures)


class _Dash:
    def __format__(self, form: str) -> str:
        return "-"


class _Figures(dict[str, object]):
    def __missing__(self, key: str) -> object:
        return _Dash()


class _Groups(dict[str, object]):
    def __missing__(self, key: str) -> object:
        return _Figures()
