"""One line where the first call on a machine compiles, which would else be a silent minute."""

import sys
from collections.abc import Callable
from functools import wraps
from typing import Any, Final, ParamSpec, TypeVar

from numba.core import event

P = ParamSpec("P")
R = TypeVar("R")

LINE: Final = (
    "spl_batch: compiling for this machine ... this takes a minute or two, once; later calls load "
    "what is compiled\n"
)


class _Notice(event.Listener):
    """Writes the line when the first kernel is compiled and not loaded."""

    written = False

    def on_start(self, _: Any) -> None:
        """A kernel is about to be compiled."""
        if not self.written:
            self.written = True
            sys.stderr.write(LINE)
            sys.stderr.flush()

    def on_end(self, _: Any) -> None:
        """It is compiled."""


_NOTICE: Final = _Notice()


def with_notice(function: Callable[P, R]) -> Callable[P, R]:
    """Write the line on standard error, once in a process, where a function compiles."""

    @wraps(function)
    def wrapped(*arguments: P.args, **named: P.kwargs) -> R:
        with event.install_listener("numba:compile", _NOTICE):
            return function(*arguments, **named)

    return wrapped
