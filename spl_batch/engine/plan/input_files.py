"""Input files by pattern, name and key, as every receiver's plan needs them."""

import glob
import hashlib
import os
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path, PurePath
from typing import Final, Protocol, TypeVar

from spl_batch.engine.settings.mistaken_file import url_fault
from spl_batch.errors import InputError, WorkflowError, named, reason_of
from spl_batch.formats.files.atomic import real_path


def refuse_own(paths: Sequence[Path], output: Path, key: str, faults: list[str]) -> None:
    """Add a fault where inputs lie among the results of the run.

    ``paths``: from :func:`expand`. ``key``: key of the workflow that they come from.
    """
    own = [path for path in paths if output in path.parents]
    if own:
        faults.append(
            f"{key}: {named(own, 1)} in the output folder {output}; name the raw files, or "
            "another output"
        )


class AnySource(Protocol):
    """An input file of any receiver."""

    @property
    def name(self) -> str:
        """What the workflow calls it."""

    @property
    def key(self) -> int:
        """What the working store calls it."""


S = TypeVar("S", bound=AnySource)


def usable(
    paths: Iterable[Path], base: Path, look: Callable[[Path, str, int], S | None]
) -> tuple[tuple[S, ...], list[InputError]]:
    """Files that can be used, by name, and what is wrong with the others.

    ``look`` makes a source of a file's path, its name and its key, or None where it holds nothing.
    """
    found, bad = [], []
    for path in paths:
        name = name_below(path, base)
        try:
            source = look(path, name, source_key(name))
        except InputError as error:
            bad.append(error)
        except OSError as error:
            bad.append(InputError(str(path), f"cannot be read: {reason_of(error)}"))
        else:
            found += [] if source is None else [source]
    check_keys(found)
    return tuple(sorted(found, key=lambda source: source.name)), bad


def check_keys(sources: Iterable[AnySource]) -> None:
    """Refuse files of different names whose keys are the same."""
    names = {source.name: source.key for source in sources}
    if len(set(names.values())) < len(names):
        raise WorkflowError("two input files share a key by chance; rename one of them")


def stem_names(sources: Sequence[AnySource]) -> dict[int, str]:
    """Names of each file's results, by key: its stem, with the key where two share it."""
    stems = Counter(Path(source.name).stem for source in sources)
    found = {}
    for source in sources:
        stem = Path(source.name).stem
        found[source.key] = stem if stems[stem] == 1 else f"{stem}_{source.key}"
    return found


def source_key(name: str) -> int:
    """Key of a file by its name: the first 63 bits of its hash."""
    return int.from_bytes(hashlib.blake2b(name.encode(), digest_size=8).digest()) >> 1


CHECK: Final = "check the path, which is relative to the folder of the workflow file"
"""What helps where a file that a workflow names is not there."""


def expand(
    names: str | Sequence[str] | None, base: Path, key: str, faults: list[str]
) -> tuple[Path, ...]:
    """Paths that patterns match, each once.

    Parameters
    ----------
    key : str
        Key of the workflow that they come from.
    faults : list of str
        A pattern that matches nothing is added to it.
    """
    if names is None:
        return ()
    found: dict[Path, None] = {}
    for name in [names] if isinstance(names, str) else names:
        if fault := url_fault(name):
            faults.append(f"{key}: {name}: {fault}")
            continue
        matches = matching(name, base)
        if not matches:
            faults.append(f"{key}: {base / name} matches no file; {CHECK}")
        elif len(matches) == 1 and not matches[0].exists():
            faults.append(f"{key}: {matches[0]} does not exist; {CHECK}")
        found.update(dict.fromkeys(map(real_path, matches)))
    return tuple(found)


def matching(name: str, base: Path) -> list[Path]:
    """Files that a path names or a pattern matches, in order; a path need not be there.

    Folders and files that have such a name are meant by it, whatever brackets it holds: only what
    follows them is a pattern.
    """
    folder, rest = base, PurePath(name).parts
    while rest and os.path.exists(folder / rest[0]):  # noqa: PTH110 - no folder of others' raises
        folder, rest = folder / rest[0], rest[1:]
    pattern = os.path.join("", *rest)  # noqa: PTH118 - as glob takes it
    if not glob.has_magic(pattern):
        return [folder / pattern]
    # Path.glob knows neither links to folders below ** nor hidden names.
    found = glob.glob(pattern, root_dir=folder, recursive=True)  # noqa: PTH207
    return sorted(folder / match for match in found)


def name_below(path: Path, base: Path) -> str:
    """What messages call a file: relative to the workflow's folder where it lies below it."""
    return path.relative_to(base).as_posix() if path.is_relative_to(base) else str(path)
