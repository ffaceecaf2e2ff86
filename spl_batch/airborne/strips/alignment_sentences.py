"""What a run says of the flightlines that it shifts, and of those that stay."""

from collections.abc import Iterable, Iterator, Sequence

from spl_batch.airborne.strips.alignment import ALONE, MOST_M, TOO_FAR, Alignment
from spl_batch.engine.findings import Finding
from spl_batch.engine.tasks.task import Receipt
from spl_batch.errors import grouped


def stay_findings(lines: Sequence[Alignment]) -> Iterator[Finding]:
    """Flightlines that stay where they should perhaps not."""
    alone = [one.name for one in lines if one.stays == ALONE]
    if alone:
        yield Finding("S02", {"kind": "alone", "count": len(alone), "names": alone})
    for one in lines:
        if one.stays == TOO_FAR:
            east, north, up = (0.0 if value is None else value for value in one.found_m)
            values = {
                "kind": "far", "east_m": east, "north_m": north, "up_m": up, "most_m": MOST_M
            }  # fmt: skip
            yield Finding("S02", values, one.name)


def plan_row(how: str) -> Iterator[tuple[str, str]]:
    """What a plan says of it, label and value; nothing where no flightline is to be shifted."""
    if how != "none":
        parts = "heights" if how == "vertical" else "coordinates"
        text = (
            f"survey.align: {how}: flightlines are compared before the ground is looked for, about "
            f"2 % of the time, and their {parts} shifted in all that follows; clouds of those that "
            "are shifted are compressed anew"
        )
        yield "alignment", text


def done_sentences(how: str, receipts: Iterable[Receipt], *, alone: bool) -> Iterator[Finding]:
    """What was done, once it is known; nothing where all flightlines fit.

    ``alone``: whether there is one flightline.
    """
    found = [[Alignment(*line) for line in receipt.facts["lines"]] for receipt in receipts]
    for lines in found:
        if not all(one.stays for one in lines):
            yield Finding("E01", {"kind": "memory", "what": done_sentence(how, lines)})
    if alone and how != "none":
        text = f"survey.align: {how}: there is one flightline, nothing is shifted"
        yield Finding("E01", {"kind": "memory", "what": text})


def done_sentence(how: str, lines: Sequence[Alignment]) -> str:
    """One sentence on what was done."""
    moved = [one for one in lines if not one.stays]
    if not moved:
        return (
            f"no flightline is shifted (survey.align: {how}): what is found of "
            f"{grouped(len(lines))} is within its own error, or cannot be told"
        )
    up = max(abs(one.up_m) for one in moved)
    across = max((one.east_m**2 + one.north_m**2) ** 0.5 for one in moved)
    far = f"{100 * up:.1f} cm in height" + (f" and {100 * across:.0f} cm in place" * (across > 0))
    noun = "flightlines was" if len(moved) == 1 else "flightlines were"
    return (
        f"{grouped(len(moved))} of {grouped(len(lines))} {noun} shifted by up to {far} "
        f"(survey.align: {how})"
    )
