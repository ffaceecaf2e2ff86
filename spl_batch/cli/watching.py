"""Watching a run while it works: on a terminal, in a log, or below a notebook's cell."""

import threading
from collections.abc import Iterator
from contextlib import contextmanager

from rich.live import Live

from spl_batch.cli.console import PlainConsole, is_screen
from spl_batch.cli.notebook import NotebookView
from spl_batch.cli.view import BEAT_S, PlainView, View

_ERR = PlainConsole(stderr=True)

REFRESH_PER_S = 4.0
"""How often the view is drawn; events between are only counted [1/s]."""


@contextmanager
def watching() -> Iterator[View]:
    """Show what happens while the block runs: on standard error, or below a notebook's cell.

    Yields
    ------
    View
        Its ``on_event`` is the ``listener`` of a verb, its ``simulated`` the ``progress`` of a
        simulation.
    """
    if _ERR.is_jupyter:
        shown = NotebookView()
        try:
            yield shown
        finally:
            shown.over()
        return
    if not is_screen(_ERR):
        plain, over = PlainView(_ERR), threading.Event()

        def beat() -> None:
            while not over.wait(BEAT_S / 10):
                plain.beat()

        threading.Thread(target=beat, daemon=True).start()
        try:
            yield plain
        finally:
            over.set()
        return
    view = View(_ERR)
    with Live(
        console=_ERR,
        get_renderable=view.draw,
        refresh_per_second=REFRESH_PER_S,
        vertical_overflow="crop",
    ):
        try:
            yield view
        finally:
            view.over()
