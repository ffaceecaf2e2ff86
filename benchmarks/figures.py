"""Every figure of the pages on methods: ``python -m benchmarks.figures [OUT]``.

The pages are ``docs/algorithms.md``, ``docs/water_surface.md`` and ``docs/altimetry_method.md``.
Options: ``--only NAME ...`` draws some, ``--folder FOLDER`` keeps the simulated surveys there and
uses again what is there. OUT is ``docs/images`` by default. Each figure shows what a benchmark
measures, by that benchmark's functions, on scenes small enough for all to take a few minutes: the
shapes are those of the full benchmarks, the last digits are not.
"""

import argparse
import tempfile
from collections.abc import Callable, Mapping, Sequence
from functools import cache
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import FuncFormatter
from numpy.typing import NDArray

from benchmarks.airborne.afterpulse import afterpulses
from benchmarks.airborne.afterpulse.afterpulse_scenes import CANOPIES, LIGHTS
from benchmarks.airborne.afterpulse.afterpulse_tables import Prepared, prepare
from benchmarks.airborne.beams.trajectories import read_trajectory
from benchmarks.airborne.filter import methods, near_surface, null_calibration
from benchmarks.airborne.filter.methods import GROUND, WIRE, Columns, is_noise, known_methods
from benchmarks.airborne.ground.terrain import cut
from benchmarks.airborne.noise import noise_density
from benchmarks.airborne.products import intensity
from benchmarks.airborne.published.twins import weak_wires
from benchmarks.altimetry import odd_tracks
from benchmarks.geiger.water import water_surface
from spl_batch import api
from spl_batch.airborne.afterpulse import afterpulse_decision, candidates
from spl_batch.airborne.beams import geometry
from spl_batch.airborne.sensors.sensor import load_preset
from spl_batch.airborne.settings import AfterpulseSettings, FilterSettings, WireSettings
from spl_batch.airborne.simulate import simulate
from spl_batch.airborne.simulate.scene.scene_file import Scene, parse_scene
from spl_batch.engine.report import style
from spl_batch.formats.files.atomic import write_bytes

LARGEST: Final = 150_000
"""Most bytes of a figure."""

PUBLISHED, TAIL, OURS, TRUTH = style.NOISE, "#d9a441", style.SIGNAL, style.MUTED
"""Colour of each method, the same in all figures; the last is the best possible or the nominal."""

POINTS: Final = 100_000
DRAWS: Final = 3
"""Noise points of a draw, and draws per density, of the first figure [count]."""

NULL_DENSITIES: Final = null_calibration.DENSITIES
"""[1/m3]"""

NEAR_SEEDS: Final = (1, 2, 3)
NEAR_M: Final = (60.0, 50.0)
FEWEST: Final = 20
LEAST: Final = 0.01
"""Scenes near surfaces, their extent [m]; bins with fewer returns are left out [count], and shares
are drawn from here on [%]."""

REMOVED: Final = 0.8
"""Share of afterpulses for which the bound is printed."""

SEED: Final = 1
WIRES_M: Final = (110.0, 64.0)
"""Extent of the scene with weak conductors [m]."""
STRIP_M: Final = 2.5
"""Half-width of the profile [m]."""
SHOWN_M: Final = (-6.0, 34.0)
"""Heights of the profile, from the lowest ground in it [m]."""

FILTERS: Final = ("published", "calibrated", "ours")
"""Filters of the profile, by name in :func:`benchmarks.airborne.filter.methods.known_methods`."""

SMALL: Final[Mapping[str, tuple[float, float]]] = MappingProxyType(
    {"edges": (190.0, 76.0), "gate 85 m": (100.0, 100.0), "channels": (90.0, 90.0)}
)
"""Extent of the scenes of :mod:`benchmarks.airborne.noise.noise_density` that are drawn [m]."""

PATCHES_M: Final = 80.0
"""Edge of the scene of reflectances [m]."""


def null_share(_: Path) -> Figure:
    """Share of pure noise that each test keeps, by the density of the noise."""
    published = FilterSettings(test="published", neighbours=15, wires=WireSettings(enabled=False))
    runs: dict[str, tuple[FilterSettings, str, str]] = {
        'published, "95 %"': (published, PUBLISHED, "s"),
        "tail, alpha 0.001": (FilterSettings(test="tail"), TAIL, "^"),
    }
    alphas = null_calibration.ALPHAS
    for alpha in alphas:
        runs[f"calibrated, alpha {alpha:g}"] = (FilterSettings(alpha=alpha), OURS, "o")
    shares: dict[str, list[float]] = {name: [] for name in runs}
    for density in NULL_DENSITIES:
        clouds = [null_calibration.interior(k, density, POINTS).cloud for k in range(DRAWS)]
        for name, (settings, _colour, _mark) in runs.items():
            kept = [null_calibration.keeps(cloud, settings).whole.mean() for cloud in clouds]
            shares[name].append(float(np.mean(kept)))
    drawn = style.figure(7.2, 3.7)
    axes = drawn.subplots()
    axes.hlines(100 * np.array(alphas), 0.017, NULL_DENSITIES[-1], colors=TRUTH, linewidth=0.8,
                linestyles=(0, (4, 3)), zorder=1)  # fmt: skip
    for name, (_settings, colour, mark) in runs.items():
        shown = np.array([100 * share if share > 0 else np.nan for share in shares[name]])
        axes.plot(NULL_DENSITIES, shown, color=colour, marker=mark,
                  markersize=4.5, linewidth=1.2)  # fmt: skip
        axes.annotate(name, (NULL_DENSITIES[-1], 100 * shares[name][-1]), (8, 0), color=colour,
                      textcoords="offset points", va="center", fontsize=8)  # fmt: skip
        tell("null_share", name, NULL_DENSITIES, shares[name])
    axes.set(xscale="log", yscale="log", xlim=(0.017, 4.5), ylim=(0.0025, 60))
    axes.set_xticks(NULL_DENSITIES, [f"{d:g}" for d in NULL_DENSITIES])
    axes.set_xticks([], minor=True)
    plain(axes)
    axes.set_xlabel("background [returns per m\N{SUPERSCRIPT THREE}]", loc="left")
    axes.set_ylabel("pure noise kept [%]")
    axes.set_title("Pure noise that is kept; dashed: alpha as asked for")
    bare(axes)
    return drawn


@cache
def weak_scene(folder: Path) -> tuple[Scene, Columns, dict[str, NDArray[np.bool_]]]:
    """Weak conductors: the scene, its returns with truth, and what each filter keeps of them."""
    scene = weak_wires(SEED, WIRES_M)
    survey = methods.make_survey(scene, folder / "figure_wires")
    known = known_methods()
    kept = {name: methods.judge(survey, known[name]) == 0 for name in FILTERS}
    return scene, methods.load_truth(survey), kept


def weak_wire(folder: Path) -> Figure:
    """Profile along a weak line: recorded, and kept by each filter, in the colours of truth."""
    scene, points, kept = weak_scene(folder)
    ends = np.array(scene.wires[1].points_m)[[0, -1]]
    unit = (ends[1] - ends[0]) / np.linalg.norm(ends[1] - ends[0])
    plan = np.column_stack([points["x"], points["y"]]) - scene.origin_m[:2] - ends[0]
    along, across = plan @ unit, plan @ np.array([-unit[1], unit[0]])
    strip = np.abs(across) < STRIP_M
    foot = points["z"][strip & (points["kind"] == GROUND)].min()
    height = points["z"] - foot
    strip &= (height > SHOWN_M[0]) & (height < SHOWN_M[1])
    along = along - along[strip].min()
    titles = {"": "As recorded", "published": "Published test keeps",
              "calibrated": "Calibrated test of single points keeps",
              "ours": "With the scan along lines"}  # fmt: skip
    drawn = style.figure(10.5, 5.6)
    kind = points["kind"]
    noise = is_noise(kind)
    layers = ((~noise & (kind != WIRE), style.RAW, 0.8), (noise, style.NOISE, 1.6),
              (kind == WIRE, OURS, 5.0))  # fmt: skip
    for axes, (name, title) in zip(drawn.subplots(2, 2, sharex=True, sharey=True).flat,
                                   titles.items(), strict=True):  # fmt: skip
        shown = strip & kept.get(name, np.ones(len(kind), dtype=np.bool_))
        for mask, colour, size in layers:
            rows = shown & mask
            axes.scatter(along[rows], height[rows], s=size, c=colour, linewidths=0)
        of_wire, of_noise = ((shown & m).sum() / (strip & m).sum() for m in (kind == WIRE, noise))
        print(f"weak_wire: {title}: wire {of_wire:.3f}, noise {of_noise:.4f} of the strip")
        axes.set_title(f"{title}: wire {100 * of_wire:.0f} %" if name else title)
        bare(axes)
    drawn.supxlabel("along the line [m]", fontsize=8.5)
    drawn.supylabel("height above the lowest ground [m]", fontsize=8.5)
    handles = [Line2D([], [], color=c, marker="o", markersize=4, linestyle="", label=label)
               for label, c in (("conductor", OURS), ("noise, afterpulses", style.NOISE),
                                ("anything else", style.RAW))]  # fmt: skip
    drawn.legend(handles=handles, loc="outside lower right", ncols=3)
    return drawn


def near_noise(folder: Path) -> Figure:
    """Noise kept, and true returns lost, by distance from surfaces and edges."""
    found = near_surface.measure(folder, NEAR_SEEDS, NEAR_M)
    names = {"published": PUBLISHED, "calibrated": TAIL, "ours": OURS}
    labels = ("published", "calibrated test", "with the scan")
    drawn = style.figure(13.2, 5.8)
    panels = drawn.subplots(2, 4, sharey=True)
    for axes, (name, bins) in zip(panels.flat, found.items(), strict=False):
        rows = [row for row in bins if row.number >= FEWEST]
        for k, (method, colour) in enumerate(names.items()):
            values = [near_surface.shares(name, row)[k] for row in rows]
            tell("near_noise", f"{name}, {method}", [row.label for row in rows], values)
            axes.plot(range(len(rows)), np.maximum(values, LEAST), color=colour, marker="so^"[k],
                      markersize=4.5, linewidth=1.2, label=labels[k])  # fmt: skip
        axes.set_xticks(range(len(rows)), [row.label.removesuffix(" m") for row in rows],
                        rotation=45, ha="right", rotation_mode="anchor")  # fmt: skip
        what = "kept" if name.startswith("noise") else "lost"
        axes.set(yscale="log", ylim=(LEAST, 130))
        axes.set_title(f"{what.capitalize()}: {name}", fontsize=9)
        plain(axes)
        bare(axes)
    for row in panels:
        row[0].set_ylabel("share [%]")
    drawn.supxlabel("distance [m]", fontsize=8.5)
    panels[0, 0].legend(loc="lower left")
    return drawn


def afterpulse_curve(folder: Path) -> Figure:
    """Afterpulses removed against vegetation lost, by threshold, in three canopies."""
    drawn = style.figure(13.2, 4.2)
    panels = drawn.subplots(1, 3, sharey=True)
    by_name = {content["name"]: content for content in (*CANOPIES, *LIGHTS)}
    for axes, name, title in (
        (panels[0], "canopy", "Crowns of 60 % cover, evenly turbid"),
        (panels[1], "clumps of leaves", "Leaves in clumps of 0.6 to 1 m"),
        (panels[2], "clumps, Easton, p 0.15", "The same under the light of Easton [W18]"),
    ):
        place = folder / f"figure_{name.replace(' ', '_')}"
        _curve(axes, name, prepare(by_name[name], place), place)
        axes.set(xlim=(-0.4, 25), ylim=(0, 100), title=title, xlabel="vegetation returns lost [%]")
        bare(axes)
    panels[0].set_ylabel("afterpulses of vegetation removed [%]")
    panels[0].legend(loc="lower right")
    return drawn


def _curve(axes: Axes, name: str, survey: Prepared, folder: Path) -> None:
    """One canopy's curves, and the points that default and published rule are at."""
    true, false = afterpulses.leaves_and_echoes(survey)
    score = afterpulses.scores(survey)
    curves = (
        ("best possible: true rates known", survey.bound, TRUTH),
        ("ours: what other beamlets see", score, OURS),
        ("lag alone, shot by shot", survey.table["afterpulse"], TAIL),
    )
    for label, values, colour in curves:
        lost, removed = by_threshold(np.asarray(values, np.float64), true, false)
        axes.plot(lost, removed, color=colour, linewidth=1.5, label=label,
                  linestyle=(0, (4, 2)) if colour == TRUTH else "-")  # fmt: skip
    echo = afterpulse_decision.resolve(survey.table, survey.density, AfterpulseSettings()).echo
    marks = (
        ("ours, by default", echo, OURS, "o"),
        ("published rule of planes", plane_rule(survey, folder), PUBLISHED, "s"),
    )
    for label, mask, colour, mark in marks:
        at = [100 * float(mask[m].mean()) for m in (true, false)]
        print(f"afterpulse_curve, {name}: {label}: lost {at[0]:.2f} %, removed {at[1]:.1f} %")
        axes.plot(*at, mark, color=colour, markersize=7, label=label)
    best = afterpulses.lost_at(survey.bound, true, false, REMOVED)
    print(f"afterpulse_curve, {name}: the bound loses {best:.2f} % where it removes "
          f"{100 * REMOVED:g} %")  # fmt: skip


def by_threshold(
    score: NDArray[np.float64], true: NDArray[np.bool_], false: NDArray[np.bool_]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Shares of true and of false ones at or above each threshold [%]."""
    limits = np.quantile(score[false][score[false] > 0], np.linspace(1, 0, 300))
    above = [np.searchsorted(np.sort(-score[m]), -limits, side="right") / m.sum()
             for m in (true, false)]  # fmt: skip
    return 100 * above[0], 100 * above[1]


def plane_rule(survey: Prepared, folder: Path) -> NDArray[np.bool_]:
    """What [W17] ch. 7 calls an afterpulse: behind a plane of its shot, channels unknown."""
    out = np.zeros(len(survey.table), dtype=np.bool_)
    loaded = read_trajectory([folder / "trajectory.csv"], survey_crs=None, trajectory_crs=None)
    for source in np.unique(survey.table["source"]):
        rows = np.flatnonzero(survey.table["source"] == source)
        rows = rows[np.lexsort([survey.table[k][rows] for k in ("index", "gps_time")])]
        table = survey.table.take(rows)
        table = table.with_columns(channel=np.zeros(len(rows), dtype=np.uint8))
        beams = geometry.beams(table, loaded.trajectory)
        chance = candidates.probability(
            table, beams, AfterpulseSettings(), load_preset("spl100"), gate_m=150.0
        )
        out[rows] = chance >= 0.5
    return out


def noise_strata(folder: Path) -> Figure:
    """Expected over true background, by stratum."""
    rows: list[tuple[str, float, float, float]] = []
    seen: dict[tuple[str, bool], noise_density.Voxels] = {}
    for name, scene, overrides, region in noise_density.STRATA:
        if scene not in SMALL or overrides:
            continue
        survey = folder / f"figure_{scene.replace(' ', '_')}"
        ratios = []
        for published in (False, True):
            key = (scene, published)
            if key not in seen:
                if not survey.exists():
                    content = {"name": scene, "seed": SEED, **noise_density.BASE,
                               **noise_density.SCENES[scene], "extent_m": SMALL[scene]}  # fmt: skip
                    simulate(parse_scene(content, scene), survey)
                more = ("noise.correction=published",) if published else ()
                seen[key] = noise_density.voxels(survey, more)
            mask = region(seen[key])
            true = float(seen[key].true[mask].sum())
            ratios.append(float(seen[key].expected[mask].sum()) / true)
        rows.append((name, ratios[0], ratios[1], true**-0.5))
        print(f"noise_strata: {name}: {ratios[0]:.3f} +- {true**-0.5:.3f}, {ratios[1]:.2f}")
    drawn = style.figure(7.2, 3.2)
    axes = drawn.subplots()
    at = np.arange(len(rows))[::-1]
    axes.axvspan(1 - noise_density.BAR, 1 + noise_density.BAR, color=style.RULE, linewidth=0)
    axes.plot([r[2] for r in rows], at, "s", color=PUBLISHED, label="published gamma")
    axes.errorbar([r[1] for r in rows], at, xerr=[2 * r[3] for r in rows], fmt="o", color=OURS,
                  markersize=5, label="seen beamlets stand in (2 SD)")  # fmt: skip
    axes.set_yticks(at, [r[0] for r in rows])
    axes.set_ylim(-0.6, len(rows) - 0.4)
    axes.set_xlabel("expected / true background returns; grey: 1 \N{PLUS-MINUS SIGN} 0.03")
    axes.set_title("Expected noise against truth")
    axes.legend(loc="center", bbox_to_anchor=(0.42, 0.5))
    bare(axes)
    return drawn


def reflectance(folder: Path) -> Figure:
    """Reflectance from detections beside the true one."""
    scene = intensity.intensity_scene(SEED, PATCHES_M)
    survey = methods.make_survey(scene, folder / "figure_reflectance")
    api.run(survey / "workflow.yaml", workers=0)
    truth = cut(survey / "truth" / "reflectance.tif", survey)
    found = cut(survey / "out" / "intensity.tif", survey)
    patch = intensity.patches(survey, scene)
    means = np.array([[np.nanmean(v[patch == k]) for v in (truth, found)]
                      for k in range(1, int(patch.max()) + 1)])  # fmt: skip
    off = means[:, 1] - means[:, 0]
    about = 1 - float((off**2).sum() / ((means[:, 0] - means[:, 0].mean()) ** 2).sum())
    print(f"reflectance: {len(means)} patches, R2 about the 1:1 line {about:.3f}")
    drawn = style.figure(10.5, 3.5)
    panels = drawn.subplots(1, 3, width_ratios=(1, 1, 1.05))
    for axes, values, title in ((panels[0], truth, "True reflectance"),
                                (panels[1], found, "From the share of beamlets seen")):  # fmt: skip
        shown = axes.imshow(values, cmap=style.DENSITY, vmin=0, vmax=0.8, interpolation="nearest",
                            extent=(0, PATCHES_M, 0, PATCHES_M))  # fmt: skip
        axes.set(title=title, xlabel="east [m]", ylabel="north [m]")
    bar = drawn.colorbar(shown, ax=panels[1], shrink=0.85)
    bar.set_label("reflectance [1]")
    panels[2].plot([0, 0.9], [0, 0.9], color=TRUTH, linewidth=0.8, linestyle=(0, (4, 3)))
    panels[2].plot(means[:, 0], means[:, 1], "o", color=OURS, markersize=3.5, alpha=0.7)
    panels[2].set(title="Means of patches", xlabel="true [1]", ylabel="found [1]", xlim=(0, 0.9),
                  ylim=(0, 0.9), aspect="equal")  # fmt: skip
    bare(panels[2])
    return drawn


def bare(axes: Axes) -> None:
    """Without the frame's upper and right side."""
    axes.spines[["top", "right"]].set_visible(False)


def plain(axes: Axes) -> None:
    """Percentages on the upright axis without powers of ten."""
    axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))


def tell(figure: str, name: str, at: Sequence[Any], values: Sequence[float]) -> None:
    """Print what is drawn."""
    pairs = ", ".join(
        f"{str(a).replace(chr(10), ' ')}: {v:.4g}" for a, v in zip(at, values, strict=True)
    )
    print(f"{figure}: {name}: {pairs}", flush=True)


FIGURES: Final[Mapping[str, Callable[[Path], Figure]]] = MappingProxyType(
    {f.__name__: f for f in (null_share, weak_wire, near_noise, afterpulse_curve, noise_strata,
                             reflectance, water_surface.water_normals, odd_tracks.water_track)}
)  # fmt: skip
"""Figure by name: given a folder for surveys, draws inside the type's context."""


def main() -> None:
    """Draw the figures that the command line names."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n", maxsplit=1)[0])
    parser.add_argument("out", nargs="?", type=Path, default=Path("docs/images"))
    parser.add_argument("--only", nargs="+", choices=list(FIGURES), default=list(FIGURES))
    parser.add_argument("--folder", type=Path)
    given = parser.parse_args()
    given.out.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as temporary, style.type_context():
        for name in given.only:
            png, _, _ = style.to_png(FIGURES[name](given.folder or Path(temporary)), LARGEST)
            write_bytes(given.out / f"{name}.png", png)
            print(f"{given.out / name}.png: {len(png)} bytes", flush=True)


if __name__ == "__main__":
    main()
