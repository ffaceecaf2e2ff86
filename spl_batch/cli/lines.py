"""What may reach a screen: lines of bounded length that a terminal only shows.

Names and texts in files are written by others. Whatever they hold, a terminal must neither obey
it nor be flooded by it.
"""

import textwrap
from typing import Final

import click

from spl_batch.errors import brief, plain

LINE_MAX: Final = 300
"""Characters of a line [count]."""

LINES_MAX: Final = 8
"""Lines of a message that tells many faults [count]."""

_BETWEEN: Final = "; "
"""What stands between the faults of a message."""


_FAULT_MAX: Final = LINE_MAX - 4
"""Characters of a fault: it stands before what stands between, and indented [count]."""


def screen_lines(text: str) -> list[str]:
    """A message as lines of at most :data:`LINE_MAX` characters, the further ones indented.

    Each of its faults is one line at most: of a longer one, which holds what a file holds, the
    middle is left out.
    """
    first, *others = (brief(fault, _FAULT_MAX) for fault in plain(text).split(_BETWEEN))
    found = [first]
    for fault in others:
        if len(found[-1]) + len(fault) + len(_BETWEEN) < LINE_MAX:
            found[-1] += _BETWEEN + fault
        else:
            found[-1] += _BETWEEN.rstrip()
            found.append(f"  {fault}")
    if len(found) > LINES_MAX:
        found = [*found[: LINES_MAX - 1], f"  … {len(found) - LINES_MAX + 1} more lines"]
    return found


def wrapped(text: str, most: int = LINE_MAX) -> list[str]:
    """All of a text, in lines of at most so many characters."""
    return textwrap.wrap(plain(text), most, subsequent_indent="  ", break_on_hyphens=False)


def say_error(text: str) -> None:
    """Print a message to standard error."""
    click.echo("\n".join(screen_lines(text)), err=True)
