"""Commands for somebody with files and without a workflow."""

from pathlib import Path

import click

from spl_batch.cli.clock import saying_if_slow
from spl_batch.cli.options import CLOCK, SETTINGS, limits

_FILE = click.Path(path_type=Path)


@click.command()
@click.argument("source", metavar="IN.laz", type=_FILE)
@click.argument("target", metavar="OUT.laz", type=_FILE)
@click.option("--trajectory", metavar="FILE", help="Where the sensor was: CSV, Parquet or SBET.")
@click.option("--sensor", metavar="NAME", help="The instrument; spl100 unless told, or hrqls.")
@click.option("--ground", is_flag=True, help="Find the ground as well: class 2.")
@click.option("--dtm", metavar="FILE.tif", type=_FILE, help="Write the terrain as a GeoTIFF.")
@click.option("--force", is_flag=True, help="Replace results that are there.")
@limits
@SETTINGS
def denoise(
    source: Path,
    target: Path,
    trajectory: str | None,
    sensor: str | None,
    ground: bool,  # noqa: FBT001 - click passes flags by name
    dtm: Path | None,
    force: bool,  # noqa: FBT001
    workers: int,
    memory: str | None,
    overrides: tuple[str, ...],
) -> int:
    """Label the noise of IN.laz in OUT.laz, without a workflow file.

    OUT.laz has every point, in order. Noise has class 7 (below the surface) or 18 (above it),
    afterpulses too; `noise_class` tells them apart. What is not given is guessed, and printed.
    """
    with saying_if_slow("loading"):
        from spl_batch import api  # noqa: PLC0415 - heavy imports stay out of --help
        from spl_batch.cli import screen  # noqa: PLC0415
        from spl_batch.cli.watching import watching  # noqa: PLC0415

    with watching() as view:
        result = api.denoise(
            source,
            target,
            trajectory=trajectory,
            sensor=sensor,
            ground=ground,
            dtm=dtm,
            force=force,
            workers=workers,
            memory=memory,
            overrides=overrides,
            listener=view.on_event,
        )
    screen.print_result(result, CLOCK.get().took_s)
    return result.exit_status


@click.command()
@click.argument("folder", type=_FILE)
@click.option("--force", is_flag=True, help="Replace a workflow that is there.")
def init(folder: Path, force: bool) -> int:  # noqa: FBT001 - click passes flags by name
    """Write a commented workflow for the files below FOLDER, and plan it.

    Headers and both ends of the files are looked at: beamlet numbers, times, CRS, trajectories,
    other clouds. What they do not tell is listed, and marked with `?` in FOLDER/workflow.yaml.
    """
    with saying_if_slow("looking at the files"):
        from spl_batch import api  # noqa: PLC0415
        from spl_batch.cli import screen  # noqa: PLC0415

        begun = api.init(folder, force=force)
    screen.print_beginning(begun)
    summary = api.plan(begun.workflow)
    screen.print_plan(summary)
    return summary.exit_status
