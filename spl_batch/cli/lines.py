"""What may reach a screen: lines of bounded length that a terminal only shows.

Names and texts in files are written by others. Whatever they hold, a terminal must neither obey
it nor be flooded by it.
"""

import textwrap
from collections.abc import Callable
from typing import Final

import click

from spl_batch.errors import brief, plain

LINE_MAX: Final = 300
"""Characters of a line [count]."""

LINES_MAX: Final = 8
"""Lines of a message that tells many faults [count]."""

_BETWEEN: Final = "; "
"""What stands between the faults of a message."""

_WORD_MAX: Final = LINE_MAX - 4
"""Characters of a word [count]: names of files are shorter, numbers of a file need not be."""

_FAULT_MAX: Final = 2 * LINE_MAX - 40
"""Characters of a fault [count]."""

DRAWN: Final[list[Callable[[str], None]]] = []
"""Of views that are drawn again and again at present: shows that the command is being stopped.

What another writes between their lines makes them appear twice.
"""


def screen_lines(text: str) -> list[str]:
    """A message as lines of at most :data:`LINE_MAX` characters, the further ones indented.

    Each of its faults takes two lines at most: what a file holds may be longer, and then its
    middle is left out.
    """
    first, *others = map(_shortened, plain(text).split(_BETWEEN))
    found = wrapped(first, LINE_MAX - 1) or [""]
    for fault in others:
        if len(found[-1]) + len(fault) + len(_BETWEEN) < LINE_MAX:
            found[-1] += _BETWEEN + fault
        else:
            found[-1] += _BETWEEN.rstrip()
            found += (f"  {line}" for line in wrapped(fault, LINE_MAX - 3))
    if len(found) > LINES_MAX:
        found = [*found[: LINES_MAX - 1], f"  … {len(found) - LINES_MAX + 1} more lines"]
    return found


def _shortened(fault: str) -> str:
    """A fault without the middle of what is too long in it."""
    words = fault.split(" ")
    return brief(" ".join(brief(word, _WORD_MAX) for word in words), _FAULT_MAX)


def wrapped(text: str, most: int = LINE_MAX) -> list[str]:
    """All of a text, in lines of at most so many characters."""
    return textwrap.wrap(plain(text), most, subsequent_indent="  ", break_on_hyphens=False)


def say_error(text: str) -> None:
    """Print a message to standard error."""
    click.echo("\n".join(screen_lines(text)), err=True)
