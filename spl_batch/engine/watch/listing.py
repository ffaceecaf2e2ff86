"""How results look where Python shows them, as a notebook does: lines that a person reads."""

from collections.abc import Iterable


def listed(name: str, rows: Iterable[tuple[str, str]]) -> str:
    """Name of a result, and below it a line for each label and value."""
    pairs = list(rows)
    width = max((len(label) for label, _ in pairs), default=0)
    return "\n".join([name, *(f"  {label:{width}}  {value}" for label, value in pairs)])
