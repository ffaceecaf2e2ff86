"""[W17] 5.4: seconds for a million points of each filter, of the stage that filters."""

import time

from benchmarks.sources import methods
from benchmarks.sources.given import Figures, Given
from spl_batch import api

METHODS = ("aes", "voxel", "published", "ours")


def measure(given: Given) -> Figures:
    """Processor seconds per million points, ``METHOD``; the second of two runs counts."""
    survey = given.survey("canopy matched")
    workflow, points = survey / "workflow.yaml", len(methods.load_truth(survey)["x"])
    found: Figures = {}
    for key in given.some(METHODS[::-1]):
        method = methods.known_methods()[key]
        overrides = [*method.settings, *method.shots, "reference=null", "output=out_seconds"]
        methods.check(workflow, overrides, method.claims)
        for _ in given.some(range(2)):
            api.run(workflow, overrides=overrides, until="shuffle", workers=0, fresh=True)
            start = time.process_time()
            api.run(workflow, overrides=overrides, until="denoise", workers=0)
            spent = time.process_time() - start
        found[key] = 1e6 * spent / points
    return found
