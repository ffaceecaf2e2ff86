"""What a reader has to know of each beam's labels."""

from collections.abc import Iterator, Sequence
from typing import Any, Final

from spl_batch.altimetry.tasks.labels import labelled
from spl_batch.engine.findings import Finding
from spl_batch.engine.report.run_record import Receipts
from spl_batch.errors import grouped

_CLUMP: Final = 20.0
"""Photons that noise comes in, at most, where it passes for signal [count]."""

_SURE_SD: Final = 5.0
"""Standard deviations by which signal has to exceed what noise alone gives."""


def beam_findings(done: Receipts) -> list[Finding]:
    """Beams whose signal may be noise, or all of whose photons are one; alike ones once."""
    found: list[Finding] = []
    for key, delivered in done["deliver_beam"].items():
        source, _, name = key.partition("/")
        beam = f"{done['index_file'][source].facts['name']}: {name}"
        kept, noise = (delivered.facts["labels"].get(k, 0) for k in ("1", "0"))
        texts = list(_of_labels(kept, noise))
        segments = [done["label"][segment].facts for segment in labelled(done, key)]
        texts += _like_noise(segments, kept)
        compared = done.get("compare", {})
        texts += compared[key].facts["said"] if key in compared else ()
        found += [Finding("P02", {"what": text}, beam) for text in texts]
    return found


def _of_labels(kept: int, noise: int) -> Iterator[str]:
    if kept and not noise:
        yield f"all {grouped(kept)} photons are signal; no noise is seen"
    if noise and not kept:
        yield f"no photon of {grouped(noise)} is signal: nothing but noise is seen"


def _like_noise(segments: Sequence[Any], kept: int) -> Iterator[str]:
    """Signal that noise alone may give: it comes in clumps of about as many as neighbours count."""
    expected = sum(one["false"] for one in segments)
    if kept and expected and kept - expected < _SURE_SD * (_CLUMP * expected) ** 0.5:
        yield (
            f"the {grouped(kept)} photons called signal cannot be distinguished from noise, which "
            f"comes in clumps ({grouped(expected)} noise photons are expected among them): signal, "
            "ground and canopy are not to be relied on"
        )
