"""Watching a run while it works: on a terminal, in a log, or below a notebook's cell."""

import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import wraps
from typing import Any

from rich.live import Live

from spl_batch.cli.console import PlainConsole, is_screen
from spl_batch.cli.notebook import NotebookView
from spl_batch.cli.view import BEAT_S, PlainView, View

_ERR = PlainConsole(stderr=True)

REFRESH_PER_S = 4.0
"""How often the view is drawn where it has changed; events between are only counted [1/s]."""


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
        console=_ERR, get_renderable=view.draw, auto_refresh=False, vertical_overflow="crop"
    ) as live:
        over = threading.Event()
        drawing = threading.Thread(target=_draw, args=(view, live, over), daemon=True)
        drawing.start()
        try:
            yield view
        finally:
            over.set()
            drawing.join()
            view.over()


def _draw(view: View, live: Live, over: threading.Event) -> None:
    """Draw the view again and again where it has changed: a terminal may be recorded."""
    seen = None
    while not over.wait(1 / REFRESH_PER_S):
        now = live.console.render_lines(view.draw())
        if now != seen:
            seen = now
            live.refresh()


def shown(verb: Callable[..., Any], tellers: Sequence[str]) -> Callable[..., Any]:
    """A verb that shows below a notebook's cell what it does.

    Parameters
    ----------
    tellers : sequence of str
        Its arguments ``listener`` or ``progress``; where a caller gives one, nothing is shown.
    """

    @wraps(verb)
    def watched(*given: Any, **options: Any) -> Any:
        if not _ERR.is_jupyter or any(name in options for name in tellers):
            return verb(*given, **options)
        with watching() as view:
            heard = {"listener": view.on_event, "progress": view.simulated}
            return verb(*given, **options, **{name: heard[name] for name in tellers})

    return watched
