"""Which codes of a report's findings tell of an effect, for scenes of which the truth is known."""

from collections.abc import Iterable, Mapping
from typing import Any


def told_by(report: Mapping[str, Any]) -> list[str]:
    """Codes of what a report warns of, and of why it lacks files."""
    return [one["code"] for part in ("findings", "failures") for one in report[part]]


def new_warnings(said: Iterable[str], usual: Iterable[str]) -> list[str]:
    """Codes that the usual ones have not."""
    known = set(usual)
    return [code for code in said if code not in known]


def telling(said: Iterable[str], of: Iterable[str]) -> list[str]:
    """Codes that are some of those that tell."""
    wanted = set(of)
    return [code for code in said if code in wanted]
