"""What may reach a screen: lines of bounded length that a terminal only shows.

Names and texts in files are written by others. Whatever they hold, a terminal must neither obey
it nor be flooded by it.
"""

import textwrap
from typing import Final

import click

from spl_batch.errors import plain

LINE_MAX: Final = 300
"""Characters of a line [count]."""

LINES_MAX: Final = 8
"""Lines of a message; the log and the report have all of it [count]."""


def screen_lines(text: str) -> list[str]:
    """A message as lines of at most :data:`LINE_MAX` characters, the further ones indented."""
    found = textwrap.wrap(plain(text), LINE_MAX, subsequent_indent="  ", break_on_hyphens=False)
    if len(found) > LINES_MAX:
        found = [*found[: LINES_MAX - 1], "  ... (the log has all of it)"]
    return found or [""]


def say_error(text: str) -> None:
    """Print a message to standard error."""
    click.echo("\n".join(screen_lines(text)), err=True)
