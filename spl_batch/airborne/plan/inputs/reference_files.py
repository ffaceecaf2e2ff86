"""Files of reference points that a workflow names: a bad one compares nothing, and fails alone."""

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import NamedTuple

from pyproj import CRS

from spl_batch.airborne.settings import ReferenceSettings
from spl_batch.errors import InputError, WorkflowError, named, told_together
from spl_batch.formats.crs import like_degrees, look_like_degrees, other_crs, parse_crs, same_crs
from spl_batch.formats.las.reader import LasFacts, inspect


class ReferenceFiles(NamedTuple):
    """Files of reference points."""

    usable: tuple[LasFacts, ...] = ()
    bad: tuple[InputError, ...] = ()


def checked_reference(
    paths: Iterable[Path],
    settings: ReferenceSettings | None,
    crs: CRS | None,
    others: Sequence[InputError],
) -> ReferenceFiles:
    """Facts of reference files in the survey's CRS, and what is wrong with the rest.

    Raises WorkflowError if every file that can be read is in another CRS: then the request is
    wrong, not the files. ``others``: files of the survey that are in another CRS themselves: any of
    them may be the wrong one.
    """
    stated = settings.crs if settings else None
    given = None if stated is None else parse_crs(stated, "reference.crs")
    usable: list[LasFacts] = []
    damaged: list[InputError] = []
    elsewhere: list[InputError] = []
    for path in paths:
        try:
            facts = inspect(path)
        except InputError as error:
            damaged.append(error)
            continue
        fault = _crs_fault(facts, facts.crs or given, crs, others)
        if fault:
            elsewhere.append(InputError(str(path), fault))
        else:
            usable.append(facts)
    if elsewhere and not usable:
        told = (f"reference.points: {text}" for text in told_together([*damaged, *elsewhere]))
        raise WorkflowError("; ".join(told))
    return ReferenceFiles(tuple(usable), (*damaged, *elsewhere))


def _crs_fault(
    facts: LasFacts, found: CRS | None, crs: CRS | None, others: Sequence[InputError]
) -> str:
    """Why a file cannot be compared with a survey of this CRS; empty if it can."""
    if found is None and facts.n_points and look_like_degrees(facts.mins_m, facts.maxs_m):
        return like_degrees([facts.mins_m, facts.maxs_m], "reference.crs")
    if crs is None or found is None or same_crs(found, crs):
        return ""
    remedy = "reproject it"
    if others:
        remedy = (
            f"nor is that of {named([error.path for error in others], 3)}: most points are "
            "in the survey's, reproject what is wrong"
        )
    return f"{other_crs(found, crs)}; {remedy}"
