"""[M20] ch. 5: coincidence processing of the artificial scene's spokes and tri-bars."""

from benchmarks.geiger.coincidence import known_scene
from benchmarks.sources.given import Figures, Given
from spl_batch.geiger.coincidence.simulate import SceneSettings

METHODS = ("published", "bridge_sign")
"""Names of :data:`~benchmarks.geiger.coincidence.known_scene.SETTINGS`."""

QUICK = {"extent_m": (5.0, 3.0)}


def measure(given: Given) -> Figures:
    """What :func:`~benchmarks.geiger.coincidence.known_scene.judge` finds, ``CLOUD.NAME``."""
    found: Figures = {}
    for part in ("spokes",) if given.quick else ("spokes", "bars"):
        content = {**known_scene.PARTS[part], **(QUICK if given.quick else {})}
        clouds = known_scene.measure(SceneSettings(seed=given.seed, **content), METHODS)
        for cloud, numbers in clouds.items():
            found |= {f"{cloud}.{name}": float(value) for name, value in numbers.items()}
    return found
