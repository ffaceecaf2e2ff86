"""Several methods on the same photon profiles; ``engine.verbs.comparing`` runs them."""

from collections import Counter
from collections.abc import Iterator, Mapping
from contextlib import ExitStack
from pathlib import Path
from typing import Any, Final, NamedTuple, get_args

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray
from pydantic import Field

from spl_batch.altimetry.photon_table import NOT_ASSESSED, SIGNAL
from spl_batch.altimetry.report.model import METHOD_NAMES, Agreement, TrackReport
from spl_batch.altimetry.report.summarise import agreement
from spl_batch.altimetry.settings import Method, TrackWorkflow
from spl_batch.engine.report import style
from spl_batch.engine.report.number_format import as_ascii, metres, number, percent, significant
from spl_batch.engine.report.page import Compared, ComparedMethod, write_comparison
from spl_batch.engine.report.parts import Count, Number, Statistics
from spl_batch.engine.report.picture import Picture
from spl_batch.engine.verbs.comparing import Methods, folder_of, per_million
from spl_batch.engine.verbs.reporting import recalled
from spl_batch.formats.verified.parquet_npz import read_groups, reading

STRETCH_M: Final = 2000.0
"""Length of track that is shown [m]."""

_COLUMNS: Final = ("along_track", "height", "signal")


class Disputed(NamedTuple):
    """The stretch of track that several methods disagree about most."""

    beam: str
    #: (n,): its photons [m].
    along_m: NDArray[np.float64]
    height_m: NDArray[np.float64]
    signal: dict[str, NDArray[np.bool_]]  #: dict of str to (n,) bool: signal by method.


class Contrast(NamedTuple):
    """Methods against the first of them."""

    #: Photons that each method keeps and the first removes, and the other way round [count].
    kept_only: Mapping[str, int]
    removed_only: Mapping[str, int]
    disputed: Disputed | None  #: None where they agree on every photon.


def contrast(outputs: Mapping[str, Path]) -> Contrast:
    """Compare the photon tables of several outputs, beam by beam.

    ``outputs``: output folder of each method; the first is what others differ from.
    """
    kept_only, removed_only = Counter[str](), Counter[str]()
    disagreed: Counter[tuple[str, int]] = Counter()
    for beam in _beams(outputs):
        for part in _groups(outputs, beam):
            signal = _signal(part)
            first = next(iter(signal.values()))
            for method, kept in signal.items():
                kept_only[method] += int(np.count_nonzero(kept & ~first))
                removed_only[method] += int(np.count_nonzero(first & ~kept))
            other = np.any([kept != first for kept in signal.values()], axis=0)
            along = next(iter(part.values()))["along_track"][other]
            stretch, count = np.unique(np.floor(along / STRETCH_M), return_counts=True)
            for at, times in zip(stretch.tolist(), count.tolist(), strict=True):
                disagreed[beam, int(at)] += times
    if not disagreed:
        return Contrast(kept_only, removed_only, None)
    worst = min(disagreed, key=lambda stretch: (-disagreed[stretch], stretch))
    return Contrast(kept_only, removed_only, _stretch(outputs, *worst))


def _beams(outputs: Mapping[str, Path]) -> list[str]:
    """Photon tables that every method has delivered."""
    listed = [
        {str(p.relative_to(out / "photons")) for p in (out / "photons").rglob("*.parquet")}
        for out in outputs.values()
    ]
    return sorted(set.intersection(*listed))


def _groups(outputs: Mapping[str, Path], beam: str) -> Iterator[dict[str, dict[str, NDArray[Any]]]]:
    """Rows of a beam by method, a row group at a time: all tables are in the order of the file."""
    with ExitStack() as stack:
        files = {
            method: stack.enter_context(reading(output / "photons" / beam))
            for method, output in outputs.items()
        }
        for group in range(next(iter(files.values())).num_row_groups):
            yield {method: read_groups(file, _COLUMNS, [group]) for method, file in files.items()}


def _signal(part: Mapping[str, Mapping[str, NDArray[Any]]]) -> dict[str, NDArray[np.bool_]]:
    """Signal by method, of the photons that all have assessed; noise elsewhere."""
    known = np.logical_and.reduce([rows["signal"] != NOT_ASSESSED for rows in part.values()])
    return {method: known & (rows["signal"] == SIGNAL) for method, rows in part.items()}


def _stretch(outputs: Mapping[str, Path], beam: str, at: int) -> Disputed:
    """Photons of a stretch of a beam."""
    along, height = [], []
    signal: dict[str, list[NDArray[np.bool_]]] = {method: [] for method in outputs}
    for part in _groups(outputs, beam):
        rows = next(iter(part.values()))
        # Photons without a position have no number and lie in no stretch.
        inside = np.floor(rows["along_track"] / STRETCH_M) == at
        along.append(rows["along_track"][inside])
        height.append(rows["height"][inside])
        for method, kept in _signal(part).items():
            signal[method].append(kept[inside])
    joined = {method: np.concatenate(kept) for method, kept in signal.items()}
    name = beam.removesuffix(".parquet")
    return Disputed(name, np.concatenate(along), np.concatenate(height), joined)


_QUANTILES: Final = (0.002, 0.998)


class TrackMethod(ComparedMethod):
    """What one method made of the photons."""

    title: str = Field(description="What a reader knows it by.")
    photons: Count = Field(description="Photons in the input files [count].")
    false_signal: Number = Field(
        None, description="Noise to be expected among it, where the method gives it [count]."
    )
    labels: Agreement | None = Field(None, description="Against the reference's labels.")
    ground: Statistics | None = Field(None, description="Ground minus reference, all beams.")
    signal_s_per_million: Number = Field(
        None, description="Stage signal, reading and writing included [s per 1e6 photons]."
    )


class TrackComparison(Compared):
    """What a comparison writes down."""

    name: str = Field(description="Title of the workflow.")
    methods: tuple[TrackMethod, ...] = Field(description="In the order asked for.")


def _picture(disputed: Disputed | None) -> Picture:
    title = "Where the methods disagree most"
    if disputed is None:
        return Picture(title, "The methods agree on every photon.")
    with style.type_context():
        return style.picture(_draw(disputed), title, f"{disputed.beam}.")


def _draw(disputed: Disputed) -> Figure:
    """The same stretch as each method sees it, below each other."""
    rows = len(disputed.signal)
    drawn = style.figure(style.WIDTH_IN, 0.5 + 1.7 * rows)
    panels = drawn.subplots(rows, 1, sharex=True, sharey=True, squeeze=False)[:, 0]
    along, height = disputed.along_m / 1000.0, disputed.height_m
    # Where the first method finds something: another may keep noise all over the gate.
    first = next(iter(disputed.signal.values()))
    shown = height[first] if first.any() else height
    low, high = np.quantile(shown, _QUANTILES)
    room = max(0.5 * (high - low), 5.0)
    for axes, (method, signal) in zip(panels, disputed.signal.items(), strict=True):
        for mine, colour, size in ((~signal, "#aab4be", 1.0), (signal, style.SIGNAL, 1.6)):
            axes.scatter(along[mine], height[mine], s=size, c=colour, linewidths=0, rasterized=True)
        axes.set_title(METHOD_NAMES[method])
        axes.set_ylabel("height [m]")
        axes.spines[["top", "right"]].set_visible(False)
        axes.ticklabel_format(useOffset=False)
    panels[0].set_ylim(low - room, high + room)
    panels[-1].set_xlabel("distance along track [km]")
    return drawn


def _keys(method: str, settings: TrackWorkflow) -> list[str] | None:
    """Keys of the workflow that make a run one of this method, and of no other beside it."""
    if method not in get_args(Method):
        return None
    keys = [f"signal.method={method}"]
    return keys if settings.reference is None else [*keys, "reference.baseline=false"]


def _write(output: Path, reports: Mapping[str, TrackReport]) -> TrackComparison:
    """Gather the table and the picture, and write them."""
    found = contrast({method: output / folder_of(method) for method in reports})
    results = tuple(_result(output, *named, found) for named in reports.items())
    first = next(iter(reports.values()))
    report = TrackComparison(name=first.name, version=first.provenance.version, methods=results)
    pictures = [_picture(found.disputed)]
    write_comparison(output, report, "compare_tracks.html.j2", __package__, pictures)
    return report


def _result(output: Path, method: str, report: TrackReport, found: Contrast) -> TrackMethod:
    done, *_ = recalled(output / folder_of(method))
    labels = Counter[str]()
    for receipt in done.get("compare", {}).values():
        labels.update(receipt.facts.get("labels", {}).get("ours", {}))
    photons = report.counts.points_in
    expected = [b.false_signal for b in report.beams if b.false_signal is not None]
    return TrackMethod(
        name=method,
        title=METHOD_NAMES[method],
        folder=folder_of(method),
        photons=photons,
        signal=report.counts.signal,
        false_signal=sum(expected) if expected else None,
        kept_only=found.kept_only[method],
        removed_only=found.removed_only[method],
        labels=agreement(**labels) if labels else None,
        ground=report.ground,
        signal_s_per_million=per_million(report.performance, "signal", photons),
        failures=len(report.failures),
    )


def _row(report: Compared, method: TrackMethod) -> tuple[str, ...]:
    del report
    values = (
        number(method.signal),
        percent(method.signal / method.photons if method.photons else None),
        number(method.labels.f1, 3) if method.labels else "-",
        metres(method.ground.rmse) if method.ground else "-",
        significant(method.signal_s_per_million),
    )
    return (method.name, *map(as_ascii, values))


METHODS: Final = Methods(
    known=", ".join(get_args(Method)),
    keys=_keys,
    until=lambda _: "index",
    share=lambda *_: {"index"},
    write=_write,
    row=_row,
    titles=("method", "signal", "of all", "F1", "ground RMSE", "s per million"),
)
"""What can be compared: beams are read once."""
