"""Warnings of each beam's labels."""

from collections.abc import Iterator

from spl_batch.altimetry.filter.window import stands_out
from spl_batch.altimetry.tasks.labels import labelled
from spl_batch.engine.findings import Finding
from spl_batch.engine.report.run_record import Receipts


def beam_findings(done: Receipts) -> Iterator[Finding]:
    """Beams whose signal may be noise, or all of whose photons are one."""
    for key, delivered in done["deliver_beam"].items():
        source, _, name = key.partition("/")
        beam = f"{done['index_file'][source].facts['name']}: {name}"
        kept, noise = (delivered.facts["labels"].get(k, 0) for k in ("1", "0"))
        false = sum(done["label"][segment].facts["false"] for segment in labelled(done, key))
        for one in of_labels(kept, noise, false, delivered.facts["floor"]):
            yield one._replace(subject=beam)


def of_labels(kept: int, noise: int, false: float, floor: int = 0) -> Iterator[Finding]:
    """What photons kept, called noise, expected to be noise among the kept, and of a floor show."""
    if kept and not noise:
        yield Finding("P02", {"kind": "all", "kept": kept})
    if noise and not kept:
        yield Finding("P02", {"kind": "none", "noise": noise})
    if kept and false and not stands_out(kept, false):
        yield Finding("P02", {"kind": "clumps", "kept": kept, "noise": round(false)})
    elif 0 < floor <= false:
        yield Finding("P02", {"kind": "floor", "floor": floor, "noise": round(false)})
