"""Files of the project that a file imports, directly or not, by its text alone.

A result depends on the code that made it. Two things need to know which code that is: receipts,
whose keys hold its hash, and numba, which keeps compiled code as long as its sources stand.
"""

import hashlib
import re
from collections.abc import Iterable, Iterator
from functools import cache
from pathlib import Path
from typing import Final

_PACKAGE: Final = Path(__file__).parent

_FROM: Final = re.compile(
    r"^[ \t]*from[ \t]+(\.*)([\w.]*)[ \t]+import[ \t]+(\([^)]*\)|.+)", re.MULTILINE
)
_IMPORT: Final = re.compile(r"^[ \t]*import[ \t]+(.+)", re.MULTILINE)
_NAME: Final = re.compile(r"\s*([\w.]+)")
_DATA: Final = re.compile(r'"(\w+\.(?:json|yaml))"')
"""Patterns, not a syntax tree: a tree of each of 170 modules takes a second at every start."""


def imported(path: Path, package: Path = _PACKAGE) -> frozenset[Path]:
    """A file, and the files of a package that it imports, directly or not.

    Imports inside functions count. So do the ``__init__.py`` of the folders above an imported
    module, since Python runs them first.

    ``package``: folder of the package; this project by default.
    """
    found, waiting = {path}, [path]
    while waiting:
        new = _direct(waiting.pop(), package) - found
        found |= new
        waiting.extend(new)
    return frozenset(found)


@cache
def module_file(name: str, package: Path = _PACKAGE) -> Path | None:
    """File of a module or package by its dotted name; None where there is none.

    Looked for once: the files of a receiver name each other thousands of times.
    """
    place = package.parent.joinpath(*name.split("."))
    files = (place.with_name(f"{place.name}.py"), place / "__init__.py")
    return next((path for path in files if path.is_file()), None)


def data_files(path: Path) -> frozenset[Path]:
    """JSON and YAML files beside a module that its text names, such as a table that it reads."""
    names = _DATA.findall(_text(path))
    return frozenset(file for name in names if (file := path.with_name(name)).is_file())


def content_hash(files: Iterable[Path]) -> str:
    """Hash of what some files hold, in the order of their paths; 32 hexadecimal digits."""
    digest = hashlib.blake2b(digest_size=16)
    for path in sorted(files):
        digest.update(path.name.encode() + hashlib.sha256(path.read_bytes()).digest())
    return digest.hexdigest()


@cache
def _direct(path: Path, package: Path) -> frozenset[Path]:
    """Files of the package that a file imports itself."""
    if not path.is_file():  # within an archive, for instance
        return frozenset()
    found = set()
    for name in _names(path, package):
        parts = name.split(".")
        if parts[0] == package.name:
            # Of "spl_batch.formats.las.reader.inspect" the last part is a function.
            files = (module_file(".".join(parts[:n]), package) for n in range(1, len(parts) + 1))
            found |= {file for file in files if file is not None}
    return frozenset(found)


def _names(path: Path, package: Path) -> Iterator[str]:
    """Dotted names that a file imports: modules, and what is taken from them."""
    text = _text(path)
    for line in _IMPORT.findall(text):
        yield from (match[1] for part in line.split(",") if (match := _NAME.match(part)))
    for dots, module, taken in _FROM.findall(text):
        base = module
        if dots:
            above = path.relative_to(package.parent).parts[: -len(dots)]
            base = ".".join([*above, *([module] if module else [])])
        yield base
        parts = taken.strip("()").split(",")
        yield from (f"{base}.{match[1]}" for part in parts if (match := _NAME.match(part)))


def _text(path: Path) -> str:
    return path.read_text(encoding="utf-8")
