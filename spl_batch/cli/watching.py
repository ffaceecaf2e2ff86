"""Watching a run while it works: on a terminal, in a log, or below a notebook's cell."""

import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import wraps
from typing import Any

from rich.live import Live

from spl_batch.cli.console import PlainConsole, is_screen
from spl_batch.cli.lines import DRAWN
from spl_batch.cli.view import BEAT_S, PlainView, View

_ERR = PlainConsole(stderr=True)


@contextmanager
def watching() -> Iterator[View]:
    """Show what happens while the block runs: on standard error, as lines below a notebook's cell.

    Yields
    ------
    View
        Its ``on_event`` is the ``listener`` of a verb, its ``simulated`` the ``progress`` of a
        simulation.
    """
    console = PlainConsole(file=sys.stdout, force_jupyter=False) if _ERR.is_jupyter else _ERR
    if not is_screen(console):
        plain, over = PlainView(console), threading.Event()

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
    with Live(console=_ERR, get_renderable=view.draw, vertical_overflow="crop"):
        DRAWN.append(view.stop)
        try:
            yield view
        finally:
            DRAWN.remove(view.stop)
            view.over()


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
