"""What tables of photons hold that a run refuses, before one is started."""

from typing import Final

from spl_batch.altimetry.plan import Inputs
from spl_batch.altimetry.tasks.index import look_through
from spl_batch.engine.verbs.receiver import FirstLook
from spl_batch.errors import InputError, WorkflowError, told_together

WHOLE_BYTES: Final = 100_000_000
"""Bytes of tables that are read to the end [byte]: a few seconds."""


def first_look(inputs: Inputs, cell_m: float) -> FirstLook:
    """Photons that cannot be used though their file's header can: tables of up to 100 MB in all.

    Raises
    ------
    WorkflowError
        If no file is left.
    """
    room, bad, lost = WHOLE_BYTES, list(inputs.bad), []
    for source in inputs.sources:
        room -= source.file.size_bytes if source.file.layout == "csv" else 0
        if source.file.layout != "csv" or room < 0:
            continue
        try:
            look_through(source.path, source.file.layout, source.beams[0].name, cell_m)
        except InputError as error:
            lost.append(source)
            bad.append(error)
    if inputs.sources and len(lost) == len(inputs.sources):
        raise WorkflowError("no input is usable: " + "; ".join(told_together(bad)))
    return FirstLook(
        tuple(told_together(bad[len(inputs.bad) :])),
        unreadable=len(lost),
        unreadable_points=sum(beam.photons for source in lost for beam in source.beams),
    )
