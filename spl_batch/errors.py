"""The project's own exceptions.

Every message is one clear line that names the file, the value and the remedy.
The command line prints it without a traceback and exits with ``exit_status``.
"""

import math
import threading
import unicodedata
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from importlib import import_module
from importlib.util import find_spec
from os import fsdecode
from typing import Any, Final


def named(names: Sequence[object], most: int = 5) -> str:
    """Up to ``most`` names, and how many more there are."""
    left = len(names) - most
    return ", ".join(map(str, names[:most])) + (f" and {left} more" if left > 0 else "")


def grouped(value: float, digits: int = 0) -> str:
    """A number as every message has it: ``1 234 567``, in plain spaces.

    Where typographic ones are at home, in a report, it is
    :func:`spl_batch.engine.report.number_format.number`.
    """
    return f"{value:,.{digits}f}".replace(",", " ")


def counted(count: int, noun: str, verb: str = "") -> str:
    """A number of things, and what they do: ``1 point``, ``2 points``, ``1 point has``.

    ``noun`` and ``verb``: in the plural.
    """
    if count != 1:
        return f"{grouped(count)} {noun} {verb}".rstrip()
    does = {"": "", "have": "has", "are": "is", "were": "was"}.get(verb, f"{verb}s")
    return f"1 {noun.removesuffix('s')} {does}".rstrip()


def storage(count: float) -> str:
    """Bytes in the largest binary unit that there is one of; nothing is shown as 0."""
    if count >= 2**30:
        return f"{grouped(count / 2**30, 2)} GiB"
    if count >= 2**20:
        return f"{grouped(count / 2**20, 1)} MiB"
    return f"{grouped(math.ceil(count / 2**10))} KiB"


FAULT_MAX: Final = 500
"""Characters of one fault; what a file holds may be longer [count]."""


def plain(text: str) -> str:
    """Text without anything that a terminal obeys or that cannot be seen: that is written out.

    Names and texts from files may hold escapes that colour, move or retitle a terminal, marks that
    turn the direction of writing round, line ends, or bytes that are no UTF-8.
    """
    return text if text.isprintable() else "".join(map(_shown, text))


def _shown(sign: str) -> str:
    """A character, or its escape where it cannot be seen."""
    if sign.isprintable() or unicodedata.category(sign) == "Zs":
        return sign
    if "\udc80" <= sign <= "\udcff":  # a byte of a name that is no UTF-8
        return f"\\x{ord(sign) - 0xDC00:02x}"
    return sign.encode("unicode_escape").decode("ascii")


def shortened(text: str, most: int) -> str:
    """Text of at most so many characters: of a longer one its start and its end."""
    if len(text) <= most:
        return text
    head = 2 * most // 3
    return f"{text[:head]} … {text[len(text) - (most - head - 3) :]}"


def shared(faults: Iterable[tuple[str, str]]) -> Iterator[str]:
    """Give each fault once, behind the names of all files that have it.

    ``faults``: name and fault of each.
    """
    alike: dict[str, list[str]] = {}
    for name, fault in faults:
        alike.setdefault(fault, []).append(name)
    for fault, names in alike.items():
        before = "" if len(names) == 1 else f"{len(names)} files: "
        yield f"{before}{named(names, 3)}: {fault}"


class SplBatchError(Exception):
    """Base of every error that this project raises on purpose."""

    exit_status = 2

    def __init__(self, message: object = "") -> None:
        super().__init__(plain(str(message)))


class WorkflowError(SplBatchError, ValueError):
    """The workflow file, or an option on the command line, is wrong."""


class InputError(SplBatchError, ValueError):
    """An input file cannot be used.

    Parameters
    ----------
    path : str
        The file that is at fault.
    faults : sequence of str
        Every fault found in it: value, what is allowed, remedy.
    """

    def __init__(self, path: str, faults: str | Sequence[str]) -> None:
        self.path = plain(path)
        given = (faults,) if isinstance(faults, str) else tuple(faults)
        self.faults = tuple(shortened(plain(fault), FAULT_MAX) for fault in given)
        super().__init__(f"{path}: {'; '.join(self.faults)}")

    def __reduce__(self) -> tuple[type["InputError"], tuple[str, tuple[str, ...]]]:
        return type(self), (self.path, self.faults)


INTERRUPTED: Final = threading.Event()
"""Set once somebody has asked this process to end: an exception may be lost in a compiler."""


def is_fault(error: BaseException) -> bool:
    """Whether something went wrong, and nobody just wants the program, or a generator, to stop.

    Libraries have exceptions of their own that derive from ``BaseException``: the Rust decoder of
    LAZ panics with one.
    """
    return not isinstance(error, KeyboardInterrupt | SystemExit | GeneratorExit)


def one_line(error: BaseException) -> str:
    """Kind and message of an exception in one line of at most 200 characters."""
    try:
        text = plain(" ".join(str(error).split()))
    except Exception as silent:  # noqa: BLE001 - it may be anything, and its kind is named
        text = f"its message cannot be written ({type(silent).__name__})"
    line = f"{type(error).__name__}: {text}" if text else type(error).__name__
    return line if len(line) <= 200 else f"{line[:197]}..."


def reason_of(error: OSError) -> str:
    """The system's reason for a file; libraries raise such errors without its words."""
    return error.strerror or " ".join(str(error).split()) or type(error).__name__


def system_fault(error: OSError, remedy: str = "") -> str:
    """File and reason of an error of the system, and what to do: by default to check both."""
    name = error.filename
    if name is None:  # raised by a library, or of something that is open
        there = remedy or "check the paths of inputs and output, and the rights there"
        return f"{reason_of(error)}; {there}"
    return f"{fsdecode(name)}: {reason_of(error)}; {remedy or 'check the path and its rights'}"


@contextmanager
def as_input_fault(path: object, what: str = "it cannot be read") -> Iterator[None]:
    """Turn whatever a library makes of a damaged file into an :class:`InputError` that names it.

    The project's own errors pass as they are, and so does a lack of memory.
    """
    try:
        yield
    except (SplBatchError, MemoryError):
        raise
    except BaseException as error:
        if not is_fault(error):
            raise
        text = f"{what} ({one_line(error)}): copy it again, or rewrite it"
        raise InputError(str(path), text) from error


def merged_faults(errors: Iterable[InputError]) -> Iterator[str]:
    """What is wrong with files, once for those that share it."""
    return shared((error.path, "; ".join(error.faults)) for error in errors)


class MissingPackageError(SplBatchError, ImportError):
    """A package that only some of the work needs is not installed."""


def needed(module: str, what: str, extra: str) -> Any:
    """Import a module that only some of the work needs.

    ``extra``: extra of this project that installs it, and what it needs.

    Raises
    ------
    MissingPackageError
        If a package is not installed: one line with the command that installs it.
    """
    try:
        return import_module(module)
    except ModuleNotFoundError as missing:
        package = str(missing.name).split(".", maxsplit=1)[0]
        if package == __name__.split(".", maxsplit=1)[0]:
            raise  # a fault of this project, not of the installation
        raise _missing(package, what, extra) from missing


def refuse_without(package: str, what: str, extra: str) -> None:
    """Raise :class:`MissingPackageError` before work that would end for want of a package."""
    if find_spec(package) is None:
        raise _missing(package, what, extra)


def _missing(package: str, what: str, extra: str) -> MissingPackageError:
    return MissingPackageError(
        f"{what} need the package {package}, which is not installed; "
        f"pip install 'spl-batch[{extra}]'"
    )


class PlanError(SplBatchError):
    """The work as planned cannot be done: too little memory or disk, nothing to do."""


class StoreError(SplBatchError):
    """The working store is not there, or not as it is needed."""


class DamagedError(StoreError):
    """A file of the working store, or a raster, is not what was written; it can be made again.

    Parameters
    ----------
    path : str
        The file, or the directory that it is part of.
    """

    exit_status = 1

    def __init__(self, path: object, reason: object) -> None:
        self.path = str(path)
        known = reason_of(reason) if isinstance(reason, OSError) else str(reason)
        self.reason = " ".join(known.split())
        super().__init__(f"{self.fault}; run again to rebuild")

    @property
    def fault(self) -> str:
        """What is wrong with which file, without what to do."""
        return f"{self.path}: damaged or missing ({self.reason})"

    def __reduce__(self) -> tuple[type["DamagedError"], tuple[str, str]]:
        return type(self), (self.path, self.reason)


class StoppedError(SplBatchError):
    """Something that concerns everything: full disk, lost scheduler. Run again to continue."""

    exit_status = 3
