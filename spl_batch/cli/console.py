"""A console for texts that others wrote, and whether somebody sits before it."""

import os
from collections.abc import Iterable

from rich.console import Console, ConsoleOptions, RenderableType
from rich.segment import Segment

from spl_batch.cli.lines import LINE_MAX
from spl_batch.errors import plain


class PlainConsole(Console):
    """A console of short lines that writes out whatever in a text a terminal would obey."""

    @property
    def options(self) -> ConsoleOptions:
        """Those of the console: on a wide screen, or a pipe that counts as one, lines are short."""
        found = super().options
        return found.update_width(min(found.max_width, LINE_MAX))

    def render(
        self, renderable: RenderableType, options: ConsoleOptions | None = None
    ) -> Iterable[Segment]:
        """Segments of something, as :class:`rich.console.Console` gives them."""
        for segment in super().render(renderable, options):
            yield segment if segment.control else _shown(segment)


def is_screen(console: Console) -> bool:
    """Whether what is printed can be drawn over later.

    `FORCE_COLOR` asks for colours, and rich then takes a pipe for a terminal. Notebooks set it for
    the commands of their cells, and show the codes that move a cursor as text. They may run these
    commands in a terminal; Jupyter's kernels set `JPY_PARENT_PID`.
    """
    terminal = console.is_interactive and console.file.isatty()
    return terminal and "JPY_PARENT_PID" not in os.environ


def _shown(segment: Segment) -> Segment:
    """A segment of text without anything but what is seen, and line ends."""
    shown = "\n".join(map(plain, segment.text.split("\n")))
    return Segment(shown, segment.style)
