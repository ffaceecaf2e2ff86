"""Tasks of coincidence processing, and its report from what they left."""

from spl_batch.geiger.coincidence.runner.tasks import KINDS, CoincidenceContext

__all__ = ["KINDS", "CoincidenceContext"]
