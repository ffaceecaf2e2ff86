"""The view of a run in a notebook: stages in one output that is drawn anew, lines that stay."""

import io
import sys
import time
from importlib import import_module
from typing import Final

from spl_batch.cli.console import PlainConsole
from spl_batch.cli.view import View
from spl_batch.engine.watch.events import Event

WIDTH: Final = 90
"""Characters of a line [count]."""

PAUSE_S: Final = 0.5
"""How long a picture stays at least [s]."""

_HTML: Final = '<pre style="line-height: 1.2; margin: 0">{code}</pre>'


class NotebookView(View):
    """Draws a run into the output of a cell, without any widget."""

    def __init__(self) -> None:
        super().__init__(PlainConsole(file=sys.stdout, force_jupyter=False, width=WIDTH))
        self._ipython = import_module("IPython.display")
        self._output = self._ipython.display(self._drawn(), raw=True, display_id=True)
        self._drawn_s = time.monotonic()

    def simulated(self, share: float) -> None:
        """Show how much of a simulation is done, 0..1."""
        super().simulated(share)
        self._refresh()

    def on_event(self, event: Event) -> None:
        """Take in an event, and draw where the last picture is old enough."""
        super().on_event(event)
        self._refresh()

    def over(self) -> None:
        """Draw what stays: the stages."""
        super().over()
        self._drawn_s = 0.0
        self._refresh()

    def _refresh(self) -> None:
        if time.monotonic() - self._drawn_s >= PAUSE_S:
            self._output.update(self._drawn(), raw=True)
            self._drawn_s = time.monotonic()

    def _drawn(self) -> dict[str, str]:
        """The view as HTML, and as text for what shows no HTML."""
        console = PlainConsole(
            file=io.StringIO(), record=True, width=WIDTH,
            force_terminal=True, force_jupyter=False, color_system="truecolor",
        )  # fmt: skip
        console.print(self.draw())
        html = console.export_html(inline_styles=True, code_format=_HTML, clear=False)
        return {"text/html": html, "text/plain": console.export_text()}
