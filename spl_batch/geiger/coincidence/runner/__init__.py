"""Tasks of coincidence processing, and its report from what they left."""

from spl_batch.geiger.coincidence.runner.intake import CoincidenceContext
from spl_batch.geiger.coincidence.runner.tasks import KINDS

__all__ = ["KINDS", "CoincidenceContext"]
