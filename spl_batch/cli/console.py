"""A console for texts that others wrote: names and texts in files are only shown."""

import os
from collections.abc import Iterable

import click
from rich.console import Console, ConsoleOptions, RenderableType
from rich.segment import Segment
from rich.text import Text

from spl_batch.errors import plain


class PlainConsole(Console):
    """A console that writes out whatever in a text a terminal would obey."""

    def render(
        self, renderable: RenderableType, options: ConsoleOptions | None = None
    ) -> Iterable[Segment]:
        """Segments of something, as :class:`rich.console.Console` gives them."""
        for segment in super().render(renderable, options):
            yield segment if segment.control else _shown(segment)

    def print_line(self, text: str, style: str = "") -> None:
        """Print a message as one line, which a terminal wraps."""
        self.print(Text(plain(text), style=style), soft_wrap=True)


def is_screen(console: Console) -> bool:
    """Whether what is printed can be drawn over later.

    `FORCE_COLOR` asks for colours, and rich then takes a pipe for a terminal. Jupyter's kernels set
    `JPY_PARENT_PID`.
    """
    terminal = console.is_interactive and console.file.isatty()
    return terminal and "JPY_PARENT_PID" not in os.environ


def print_error(text: str) -> None:
    """Print a message to standard error."""
    click.echo(plain(text), err=True)


def _shown(segment: Segment) -> Segment:
    """A segment of text without anything but what is seen, and line ends."""
    shown = "\n".join(map(plain, segment.text.split("\n")))
    return Segment(shown, segment.style)
