"""The command line: parse, call the API, print, exit status."""

import atexit
import errno
import os
import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NoReturn

import click
from click.shell_completion import get_completion_class

from spl_batch import api
from spl_batch.cli import document
from spl_batch.cli.console import print_error
from spl_batch.errors import INTERRUPTED, SplBatchError, system_fault

_CONTINUES = frozenset({"run", "quickstart", "compare", "denoise"})
"""Commands that go on where they stopped."""

_STAGES = "index, shots, shuffle, denoise, ground, surfaces, deliver, report"

_FILE = click.Path(path_type=Path)
WORKFLOW = click.argument("workflow", type=_FILE)
OUTPUT = click.argument("output", type=_FILE)
SETTINGS = click.option(
    "--set",
    "overrides",
    multiple=True,
    metavar="KEY.PATH=VALUE",
    help="Set a key of the workflow; repeatable.",
)
JSON = click.option("--json", "as_json", is_flag=True, help="Print one JSON document instead.")
WORKERS = click.option(
    "--workers", default=2, show_default=True, help="Worker processes; 0 works in this one."
)
MEMORY = click.option(
    "--memory",
    metavar="SIZE",
    show_default="four fifths of the machine's, shared by the workers, 16GiB at most; "
    "4GiB with a scheduler",
    help="Memory limit of a worker, such as 4GiB.",
)


def limits(command: Any) -> Any:
    """Options of how much of the machine may be used."""
    return WORKERS(MEMORY(command))


def _show_version(context: click.Context, _: click.Parameter, wanted: bool) -> None:  # noqa: FBT001 - click's
    """Print which build this is."""
    if wanted and not context.resilient_parsing:
        from spl_batch.engine.tasks.runner import build_version  # noqa: PLC0415

        click.echo(f"spl-batch, version {build_version()}")
        context.exit()


@click.group(context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100})
@click.option(
    "--version",
    is_flag=True,
    is_eager=True,
    expose_value=False,
    callback=_show_version,
    help="Show the version and exit.",
)
def cli() -> None:
    """Raw single-photon lidar surveys to clean point clouds and terrain.

    Start with `spl-batch quickstart`, or write a workflow file and `spl-batch run` it.
    """


@cli.command()
@click.argument("folder", type=_FILE, default=Path("spl-quickstart"))
@limits
def quickstart(folder: Path, **options: Any) -> int:
    """Simulate a small survey into FOLDER and run the whole chain on it."""
    from spl_batch.cli import screen, view  # noqa: PLC0415

    with view.watching() as seen:
        result = api.quickstart(folder, progress=seen.simulated, listener=seen.on_event, **options)
    screen.print_result(result)
    return result.exit_status


@cli.command()
@click.argument("scene", type=_FILE)
@OUTPUT
def simulate(scene: Path, output: Path) -> int:
    """Fly a synthetic survey of SCENE into OUTPUT, with truth for every point."""
    from spl_batch.cli import screen, view  # noqa: PLC0415

    with view.watching() as seen:
        summary = api.simulate(scene, output, progress=seen.simulated)
    screen.print_simulation(summary, output)
    return 0


@cli.command()
@WORKFLOW
@limits
@SETTINGS
@JSON
def plan(workflow: Path, as_json: bool, **options: Any) -> int:  # noqa: FBT001 - click passes flags by name
    """Estimate what a run of WORKFLOW would do, and name what is wrong with its inputs."""
    from spl_batch.cli import screen  # noqa: PLC0415

    summary = api.plan(workflow, **options)
    if as_json:
        document.print_document(document.of_plan(summary))
    else:
        screen.print_plan(summary)
    return summary.exit_status


@cli.command()
@WORKFLOW
@limits
@click.option("--scheduler", metavar="tcp://HOST:PORT", help="Use a running dask scheduler.")
@click.option("--fresh", is_flag=True, help="Forget what earlier runs finished.")
@click.option(
    "--until", metavar="STAGE", help=f"Stop after this stage; of an airborne survey: {_STAGES}."
)
@SETTINGS
@JSON
def run(workflow: Path, as_json: bool, **options: Any) -> int:  # noqa: FBT001 - click passes flags by name
    """Process the survey of WORKFLOW; run again, it continues where it stopped."""
    from spl_batch.cli import view  # noqa: PLC0415

    with view.watching() as seen:
        seen.loading()
        from spl_batch.cli import screen  # noqa: PLC0415

        result = api.run(workflow, listener=seen.on_event, **options)
    if as_json:
        document.print_document(document.of_result(result))
    else:
        screen.print_result(result)
    return result.exit_status


@cli.command()
@WORKFLOW
@click.option(
    "--methods",
    required=True,
    metavar="A,B[,...]",
    help="Methods to compare, e.g. vsaes,aes,published, or of photon profiles likelihood,mdbscan; "
    "the first is the yardstick.",
)
@limits
@SETTINGS
def compare(workflow: Path, methods: str, **options: Any) -> int:
    """Run several methods on the inputs of WORKFLOW: a table, and profiles side by side."""
    from spl_batch.cli import screen, view  # noqa: PLC0415

    with view.watching() as seen:
        result = api.compare(workflow, methods, listener=seen.on_event, **options)
    screen.print_comparison(result)
    return result.exit_status


@cli.command()
@OUTPUT
@click.option(
    "--watch", is_flag=True, help="Show it until the run ends; wait for one that has not begun."
)
@JSON
def status(output: Path, watch: bool, as_json: bool) -> int:  # noqa: FBT001 - click passes flags by name
    """Show what is done, running, failed and left in OUTPUT, also while a run works there."""
    from spl_batch.cli import screen  # noqa: PLC0415

    if watch and as_json:
        raise click.UsageError("--json prints one document: leave out --watch")
    if as_json:
        document.print_document(document.of_status(api.status(output)))
    elif watch:
        screen.await_run(output)
        screen.watch_status(api.Follower(output))
    else:
        screen.print_status(api.status(output))
    return 0


@cli.command()
@OUTPUT
def report(output: Path) -> int:
    """Write the report of OUTPUT again from what is on disk."""
    from spl_batch.cli import screen  # noqa: PLC0415

    result = api.report(output)
    screen.print_result(result)
    return int(result.exit_status)


@cli.command()
@click.argument("source", metavar="IN.laz", type=_FILE)
@click.argument("target", metavar="OUT.laz", type=_FILE)
@click.option("--trajectory", metavar="FILE", help="Where the sensor was: CSV, Parquet or SBET.")
@click.option("--sensor", metavar="NAME", help="The instrument, such as hrqls; by default spl100.")
@click.option("--ground", is_flag=True, help="Find the ground as well: class 2.")
@click.option("--dtm", metavar="FILE.tif", type=_FILE, help="Write the terrain as a GeoTIFF.")
@click.option("--force", is_flag=True, help="Replace results that are there.")
@limits
@SETTINGS
def denoise(source: Path, target: Path, **options: Any) -> int:
    """Label the noise of IN.laz in OUT.laz, without a workflow file.

    OUT.laz has every point, in order. Noise has class 7 (below the surface) or 18 (above it),
    afterpulses too; `noise_class` distinguishes them. What is not given is guessed, and printed.
    """
    from spl_batch.cli import screen, view  # noqa: PLC0415

    with view.watching() as seen:
        result = api.denoise(source, target, listener=seen.on_event, **options)
    screen.print_result(result)
    return result.exit_status


@cli.command()
@click.argument("folder", type=_FILE)
@click.option("--force", is_flag=True, help="Replace a workflow that is there.")
def init(folder: Path, force: bool) -> int:  # noqa: FBT001 - click passes flags by name
    """Write a commented workflow for the files below FOLDER, and plan it.

    Headers and both ends of the files are looked at: beamlet numbers, times, CRS, trajectories,
    other clouds. What they do not hold is listed, and marked with `?` in FOLDER/workflow.yaml.
    """
    from spl_batch.cli import screen  # noqa: PLC0415

    begun = api.init(folder, force=force)
    screen.print_beginning(begun)
    summary = api.plan(begun.workflow)
    screen.print_plan(summary)
    return summary.exit_status


@cli.command()
@click.argument("shell", type=click.Choice(["bash", "zsh", "fish"]))
def completion(shell: str) -> int:
    """Print what completes commands and options in SHELL.

    For bash: `eval "$(spl-batch completion bash)"` in ~/.bashrc; zsh likewise in ~/.zshrc; for fish
    `spl-batch completion fish > ~/.config/fish/completions/spl-batch.fish`.
    """
    made = get_completion_class(shell)
    if made is None:
        raise click.UsageError(f"click knows no completion of {shell}")
    click.echo(made(cli, {}, "spl-batch", "_SPL_BATCH_COMPLETE").source())
    return 0


def main(arguments: list[str] | None = None) -> None:
    """Run the command line and exit with the status of the contract."""
    given = sys.argv[1:] if arguments is None else arguments
    as_json = "--json" in given
    goes_on = "; the same command continues" if given[:1] and given[0] in _CONTINUES else ""
    try:
        with _ended_in_order():
            status = cli.main(args=arguments, prog_name="spl-batch", standalone_mode=False)
    except click.ClickException as error:
        error.show()
        _end("", 2, error.format_message() if as_json else "")
    except (click.Abort, KeyboardInterrupt):
        _end(f"interrupted{goes_on}", 3, as_json and "interrupted")
    except SplBatchError as error:
        _end(f"spl-batch: {error}", error.exit_status, as_json and str(error))
    except TimeoutError as error:
        text = f"{str(error) or 'no answer in time'}; the machine is busy, run again to continue"
        _end(f"spl-batch: {text}", 3, as_json and text)
    except OSError as error:
        full = error.errno in {errno.ENOSPC, errno.EDQUOT}
        text = system_fault(error, "free some space and run again" if full else "")
        _end(f"spl-batch: {text}", 3 if full else 2, as_json and text)
    except Exception:  # an interrupt may come up as something else, as in a compiler's callback
        if not INTERRUPTED.is_set():
            raise
        _end(f"interrupted{goes_on}", 3, as_json and "interrupted")
    status = status if isinstance(status, int) else 0
    if arguments is None:
        _leave(status)
    sys.exit(status)


def _leave(status: int) -> None:
    """End this process at once: taking apart every module that is loaded takes a second."""
    if all(t.daemon for t in threading.enumerate() if t is not threading.current_thread()):
        atexit._run_exitfuncs()  # noqa: SLF001 - as multiprocessing does before os._exit
        try:
            sys.stdout.flush()
            sys.stderr.flush()
        except (OSError, ValueError, AttributeError):  # of a pipe that is closed
            return
        os._exit(status)


def _end(text: str, status: int, document_text: object = "") -> NoReturn:
    """Print why the command ends, and end it."""
    if text:
        print_error(text)
    if document_text:
        document.print_error(str(document_text), status)
    sys.exit(status)


@contextmanager
def _ended_in_order() -> Iterator[None]:
    """Take the end of a queue system's time like Ctrl-C: in order, to be continued."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return

    def interrupt(*_: object) -> None:
        INTERRUPTED.set()
        raise KeyboardInterrupt

    INTERRUPTED.clear()
    signs = [s for s in (signal.SIGTERM, signal.SIGINT) if signal.getsignal(s) != signal.SIG_IGN]
    before = [(sign, signal.signal(sign, interrupt)) for sign in signs]
    try:
        yield
    finally:
        for sign, handler in before:
            signal.signal(sign, handler)
