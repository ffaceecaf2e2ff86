"""Frames for calibration are read before anything starts.

Without one of its distances a calibration would silently be another, so a damaged file of a target
ends the run. These files are few: ``plan`` and ``run`` read them through, and refuse with the same
words.
"""

from spl_batch.engine.tasks.worklist import Worklist
from spl_batch.errors import InputError, WorkflowError
from spl_batch.geiger.water.plan import WaterLedger
from spl_batch.geiger.water.steps import STEPS
from spl_batch.geiger.water.tasks.surfaces import WaterContext, calibrated, read_through

WITHOUT = "without a calibration there are no ranges"
"""Why a run stops."""


def refuse_unusable(ledger: WaterLedger, context: WaterContext) -> None:
    """Read the frames of all targets, unless an earlier run has, and fit the laws to them.

    Raises
    ------
    WorkflowError
        If a file cannot be read to its end, or the laws cannot be fitted.
    """
    targets = ledger.inputs.targets
    if not targets or _is_calibrated(ledger, context):
        return
    faults, counted = [], []
    for target in targets:
        try:
            found = read_through(target.path, target.facts.frames, ledger.workflow, target=True)
        except InputError as error:
            faults.append(str(error))
        else:
            counted.append(found.whole)
    if not faults:
        try:
            calibrated(counted, [target.distance_m for target in targets], ledger.workflow)
        except InputError as error:
            faults.append(str(error))
    if faults:
        raise WorkflowError(f"{WITHOUT}: {'; '.join(faults)}")


def _is_calibrated(ledger: WaterLedger, context: WaterContext) -> bool:
    """Whether an earlier run has finished the calibration that this one needs."""
    # A ledger of its own: what is looked at here says nothing of what the run will find.
    spare = WaterLedger(ledger.inputs, ledger.workflow, ledger.memory_bytes, ledger.workers)
    found = [
        receipt is not None
        for step in (STEPS["count_frames"], STEPS["calibrate"])
        for task, receipt in Worklist(step, spare, context).look()
        if task.kind == "calibrate"
    ]
    return found == [True]
