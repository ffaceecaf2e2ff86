"""All sentences of a report on noise, ranges and places that do not fit their model, in order."""

from collections.abc import Iterator

from spl_batch.airborne.context import Context
from spl_batch.airborne.report.fit.clouds import haze_warning
from spl_batch.airborne.report.fit.fog import fog_warning, thin_haze_warning
from spl_batch.airborne.report.fit.layers import misfit_warning
from spl_batch.airborne.report.fit.noise_fit import float_warning, uniform_warning
from spl_batch.airborne.report.fit.sky import drowned_warning, kept_warning
from spl_batch.airborne.report.noise_model import Haze
from spl_batch.engine.report.run_record import Receipts


def noise_warnings(done: Receipts, context: Context, haze: Haze | None) -> Iterator[str]:
    """Sentences with number, place and consequence.

    ``haze``: that of :func:`~spl_batch.airborne.report.fit.clouds.haze`.
    """
    workflow = context.workflow
    yield from haze_warning(haze)
    yield from fog_warning(done)
    yield from thin_haze_warning(done)
    yield from misfit_warning(done, context)
    yield from drowned_warning(done)
    yield from kept_warning(done, workflow.filter)
    yield from uniform_warning(done)
    yield from float_warning(done, workflow.filter)
