"""[W17] 5.4: seconds for a million points of each filter, by the stage that filters."""

from benchmarks.sources import methods
from benchmarks.sources.given import Figures, Given
from spl_batch import api
from spl_batch.engine.verbs.comparing import per_million

METHODS = ("aes", "voxel", "published", "ours")


def measure(given: Given) -> Figures:
    """Seconds per million points of one core, ``METHOD``; the second of two runs counts."""
    workflow = given.survey("canopy matched") / "workflow.yaml"
    found: Figures = {}
    for key in METHODS:
        method = methods.known_methods()[key]
        overrides = [*method.settings, *method.shots, "reference=null", "output=out_seconds"]
        methods.check(workflow, overrides, method.claims)
        for _ in range(2):
            done = api.run(workflow, overrides=overrides, until="denoise", workers=0, fresh=True)
        report = done.report
        found[key] = per_million(report.performance, "denoise", report.counts.points_in) or 0.0
    return found
