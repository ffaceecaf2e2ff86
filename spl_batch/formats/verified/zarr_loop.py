"""Zarr's event loop, ended in order.

Zarr works in a thread of its own. When the process ends it gives that thread a fifth of a second
to stop, and then closes the loop, whether it has stopped or not: on a busy machine that is a
traceback after a run that is finished.
"""

import atexit
from typing import Final

from zarr.core import sync

PATIENCE_S: Final = 60.0
"""How long the thread may take to stop [s]."""


def stop_loop() -> None:
    """Stop Zarr's loop and close it; Zarr makes another one where it needs it."""
    loop, thread = sync.loop[0], sync.iothread[0]
    if loop is None or thread is None:
        return
    loop.call_soon_threadsafe(loop.stop)
    thread.join(PATIENCE_S)
    if not thread.is_alive():
        loop.close()
        sync.loop[0], sync.iothread[0] = None, None


def end_in_order() -> None:
    """Have the loop stopped when the process ends, before Zarr does: what is told last comes first.

    Each module that hands work to Zarr asks for it.
    """
    atexit.unregister(stop_loop)
    atexit.register(stop_loop)
