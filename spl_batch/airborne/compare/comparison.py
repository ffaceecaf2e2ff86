"""Run several filters on one survey and write down how they differ.

Each method gets a folder of its own, ``OUTPUT/compare/METHOD``, with everything that a run
gives: clouds, rasters, report, store. What the methods have in common, up to the point
tiles, is done once in the store of ``OUTPUT`` itself (or was, by an earlier run) and linked
into theirs. Receipts decide what is left to do, so a comparison that was stopped goes on
where it was, and one more method costs that method alone.
"""

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Final, get_args

from spl_batch.airborne.compare.comparison_page import (
    ComparisonReport,
    MethodResult,
    write_comparison,
)
from spl_batch.airborne.compare.contrast import FAR_M, Contrast, Outcome, contrast
from spl_batch.airborne.filter.denoise import METHODS
from spl_batch.airborne.plan.block_size import Holders, remember_stretch, remembered_stretch
from spl_batch.airborne.report.model import Report
from spl_batch.airborne.report.plots import Profile
from spl_batch.airborne.report.profile_strips import read_strip, tallest_strip
from spl_batch.airborne.report.verdicts import noise_removed
from spl_batch.airborne.settings import FilterSettings
from spl_batch.airborne.settings.workflow import Workflow, load_workflow
from spl_batch.airborne.tasks.kinds import KINDS
from spl_batch.engine.report.number_format import (
    as_ascii,
    centimetres,
    number,
    percent,
    significant,
)
from spl_batch.engine.store.links import share_finished
from spl_batch.engine.store.output_lock import locked
from spl_batch.engine.store.output_owner import usable
from spl_batch.engine.store.working_store import Store
from spl_batch.engine.verbs.comparing import ComparisonResult
from spl_batch.engine.verbs.preparing import prepare
from spl_batch.engine.verbs.reporting import recalled
from spl_batch.engine.verbs.running import run
from spl_batch.engine.watch.earlier_runs import share_time
from spl_batch.engine.watch.events import Listener, Note, ignore
from spl_batch.errors import WorkflowError
from spl_batch.formats.rasters.parts import read_overview
from spl_batch.lattice.tiles import Bounds, quanta

FOLDER: Final = "compare"
"""Where the methods' results lie, below the output folder."""

TESTS: Final = tuple(get_args(FilterSettings.model_fields["test"].annotation))
"""Tests of our own method."""

OWN: Final = "vsaes"
"""The method that has several tests."""

PUBLISHED: Final = "published"
"""The whole chain of [W18], as a method: test, ellipsoid, noise, and no afterpulses before it."""

PUBLISHED_FILTER: Final = (
    f"filter.method={OWN}", "filter.test=published", "filter.neighbours=15", "filter.radius_m=1.5",
)  # fmt: skip
"""Its filter."""

PUBLISHED_NOISE: Final = ("noise.correction=published", "afterpulse.enabled=false")
"""What the filter looks at; the other methods have the workflow's own."""


@dataclass(frozen=True, slots=True)
class Variant:
    """A method, and its test where it has several.

    Parameters
    ----------
    method : str
        A value of ``filter.method``, or :data:`PUBLISHED`.
    test : str
        A value of ``filter.test``; empty for the workflow's own.
    """

    method: str
    test: str = ""

    @property
    def name(self) -> str:
        """As it was asked for."""
        return f"{self.method}:{self.test}" if self.test else self.method

    @property
    def folder(self) -> str:
        """Name of its folder."""
        return self.name.replace(":", "-")

    def store(self, output: Path, url: str | None) -> Store:
        """Its working store: each variant has one of its own."""
        return Store(output, f"{url.rstrip('/')}/{FOLDER}/{self.folder}" if url else None)

    def overrides(self, output: Path, url: str | None) -> list[str]:
        """Keys of the workflow that make a run one of this variant."""
        keys = [f"output={json.dumps(str(output))}"]
        if url:
            keys.append(f"outputs.store={json.dumps(self.store(output, url).url)}")
        if self.method == PUBLISHED:
            return [*keys, *PUBLISHED_FILTER, *PUBLISHED_NOISE]
        keys.append(f"filter.method={self.method}")
        return [*keys, f"filter.test={self.test}"] if self.test else keys


def compare(
    workflow: Path | str,
    methods: str | Sequence[str],
    *,
    workers: int = 2,
    memory: str | int | None = None,
    overrides: Sequence[str] = (),
    listener: Listener = ignore,
) -> ComparisonResult:
    """Run several filters on one survey; see :func:`spl_batch.engine.verbs.comparing.compare`."""
    variants = parse_methods(methods)
    path = Path(workflow)
    settings = load_workflow(path, overrides)
    output = (path.resolve().parent / settings.output).resolve()
    url = settings.outputs.store
    for variant in variants:
        load_workflow(path, [*overrides, *variant.overrides(output, url)])
    usable(prepare(path, overrides, memory=memory, workers=workers))  # before the lock's file
    process = partial(run, path, workers=workers, memory=memory, listener=listener)
    with locked(output / FOLDER):
        # What the methods share is finished first, under the workflow's own settings.
        status = process(until="shuffle", overrides=overrides).exit_status
        reports: dict[str, Report] = {}
        for number, variant in enumerate(variants, start=1):
            listener(Note("info", f"{variant.name}, {number} of {len(variants)}"))
            folder = output / FOLDER / variant.folder
            _share(Store(output, url), variant.store(folder, url), settings, variant)
            result = process(overrides=[*overrides, *variant.overrides(folder, url)])
            status = max(status, result.exit_status)
            if result.report is not None:
                reports[variant.name] = result.report
        report = _write(output, variants, reports)
    rows = tuple(_row(method) for method in report.methods)
    return ComparisonResult(status, output, report, TITLES, rows)


TITLES: Final = ("filter", "signal", "noise", "far noise", "DTM RMSE", "DSM RMSE", "s per million")
"""Columns that the console shows."""


def _row(method: MethodResult) -> tuple[str, ...]:
    values = (
        number(method.signal),
        percent(method.removed_share),
        percent(method.far_share, 3),
        centimetres(method.dtm_rmse_m),
        centimetres(method.dsm_rmse_m),
        significant(method.denoise_s_per_million),
    )
    return (method.name, *map(as_ascii, values))


def parse_methods(methods: str | Sequence[str]) -> list[Variant]:
    """Variants of a list such as ``"vsaes:tail,voxel"``, each once, in the order given.

    Raises
    ------
    WorkflowError
        If a name is not known, or fewer than two are given.
    """
    listed = methods.split(",") if isinstance(methods, str) else methods
    variants = list(dict.fromkeys(_variant(name.strip()) for name in listed if name.strip()))
    if len(variants) < 2:
        raise WorkflowError(f"--methods: name two or more of {_known()}, separated by commas")
    return variants


def _variant(name: str) -> Variant:
    method, colon, test = name.partition(":")
    if method not in (*METHODS, "none", PUBLISHED):
        raise WorkflowError(f"--methods: no method {method!r}; there are {_known()}")
    if colon and (method != OWN or test not in TESTS):
        raise WorkflowError(f"--methods: no method {name!r}; there are {_known()}")
    return Variant(method, test)


def _known() -> str:
    tested = ", ".join(f"{OWN}:{test}" for test in TESTS)
    return f"{', '.join(METHODS)}, none; {tested}; and {PUBLISHED}"


def _share(source: Store, target: Store, settings: Workflow, variant: Variant) -> None:
    """Link what the workflow's own run has finished and the variant can use."""
    stages, kinds = {"index"}, ["reference"]
    if variant.method != PUBLISHED:
        stages.add("shots")
        # The points of a tile carry the verdict of single shots, which one method alone asks for.
        # Bloom is marked for all but an unfiltered survey.
        marked = settings.noise.bloom and "none" in (settings.filter.method, variant.method)
        if (settings.filter.method == "dcc") == (variant.method == "dcc") and not marked:
            stages.add("shuffle")
    kinds += [name for name, kind in KINDS.items() if kind.stage in stages]
    share_finished(source, target, kinds)
    points = remembered_stretch(source)
    if "shots" in stages and points is not None:
        remember_stretch(target, points)  # what is shared is cut by it, whatever memory there is
    share_time(source.output, target.output, stages)


def _write(
    output: Path, variants: Sequence[Variant], reports: Mapping[str, Report]
) -> ComparisonReport:
    """Gather the table and the pictures, and write them."""
    runs = {}
    for variant in variants:
        done, context, _ = recalled(output / FOLDER / variant.folder)
        holders = Holders(done.get("denoise", {}), quanta(context.workflow.tiling.tile_m))
        runs[variant.name] = Outcome(done, context, holders.of)
    found = contrast(list(runs.values()))
    first = reports[variants[0].name]
    results = tuple(
        _result(variant, reports[variant.name], found, k) for k, variant in enumerate(variants)
    )
    report = ComparisonReport(
        survey=first.survey.name,
        version=first.provenance.version,
        far_m=FAR_M,
        far_m3=found.far_m3 or None,
        far_recorded_per_m3=found.far_points / found.far_m3 if found.far_m3 else None,
        methods=results,
        left_out=tuple(found.left_out),
    )
    write_comparison(output, report, list(_profiles(runs, found)))
    return report


def _result(variant: Variant, report: Report, found: Contrast, k: int) -> MethodResult:
    counts, accuracy = report.counts, report.accuracy
    dtm = accuracy.dtm.get("all") if accuracy else None
    dsm = accuracy.dsm.get("all") if accuracy else None
    kept = int(found.far_kept[k])
    return MethodResult(
        name=variant.name,
        folder=f"{FOLDER}/{variant.folder}",
        points=counts.points_in,
        signal=counts.signal,
        background=counts.background,
        afterpulse=counts.afterpulse,
        removed_share=noise_removed(report),
        kept_only=int(found.kept_only[k]),
        removed_only=int(found.removed_only[k]),
        far_per_m3=kept / found.far_m3 if found.far_m3 else None,
        far_share=kept / found.far_points if found.far_points else None,
        dtm_rmse_m=dtm.rmse if dtm else None,
        dtm_mean_m=dtm.mean if dtm else None,
        dsm_rmse_m=dsm.rmse if dsm else None,
        shuffle_s_per_million=_per_million(report, "shuffle"),
        denoise_s_per_million=_per_million(report, "denoise"),
        failures=len(report.failures),
    )


def _per_million(report: Report, stage: str) -> float | None:
    cost = report.performance.stages.get(stage)
    points = report.counts.points_in
    return 1e6 * cost.wall_s / points if cost and cost.wall_s and points else None


def _profiles(
    runs: Mapping[str, Outcome], found: Contrast
) -> Iterator[tuple[str, str, dict[str, Profile]]]:
    """The strip where most stands on the ground, and the one that is most disputed."""
    path = next(iter(runs.values())).context.output / "chm.tif"
    if path.exists():
        yield (
            "Where most stands on the ground",
            "Look for wires, roof edges and crowns that are kept, and for what is left between.",
            _strips(runs, tallest_strip(read_overview(path))),
        )
    if found.disputed is not None:
        yield (
            "Where the filters disagree most",
            "Look for what one filter keeps and another removes near the surface.",
            _strips(runs, found.disputed),
        )


def _strips(runs: Mapping[str, Outcome], strip: Bounds) -> dict[str, Profile]:
    cut = {name: read_strip(strip, run.done, run.context) for name, run in runs.items()}
    return {name: profile for name, profile in cut.items() if profile is not None}
