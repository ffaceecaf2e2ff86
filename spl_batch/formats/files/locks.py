"""A lock on an open file that the system drops when the process ends, on POSIX and Windows."""

import os
import sys
from typing import Any, Final

_BEYOND: Final = 1 << 40
"""Byte that is locked on Windows, beyond the content, which others may then still read."""

if sys.platform == "win32":
    import msvcrt

    def lock(stream: Any, *, shared: bool = False) -> None:  # noqa: ARG001 - Windows has one kind
        """Take it; raises BlockingIOError where another process has it."""
        os.lseek(stream.fileno(), _BEYOND, os.SEEK_SET)
        try:
            msvcrt.locking(stream.fileno(), msvcrt.LK_NBLCK, 1)
        except PermissionError as error:
            raise BlockingIOError(error.errno, str(error)) from None
        finally:
            os.lseek(stream.fileno(), 0, os.SEEK_SET)

else:
    import fcntl

    def lock(stream: Any, *, shared: bool = False) -> None:
        """Take it; raises BlockingIOError where another process has it.

        ``shared``: along with others that do so; on Windows alone as well.
        """
        fcntl.flock(stream, (fcntl.LOCK_SH if shared else fcntl.LOCK_EX) | fcntl.LOCK_NB)
