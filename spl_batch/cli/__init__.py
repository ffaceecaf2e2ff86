"""The command line: parse, call the API, print, exit status."""

import _thread
import atexit
import errno
import io
import os
import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, NoReturn

import click
from click.shell_completion import get_completion_class

from spl_batch.cli import document
from spl_batch.cli.clock import CommandClock, process_age_s, saying_if_slow
from spl_batch.cli.first_use import denoise, init
from spl_batch.cli.lines import DRAWN, say_error
from spl_batch.cli.options import CLOCK, OUTPUT, SETTINGS, WORKFLOW, limits
from spl_batch.errors import SplBatchError, told_by_system

_AGAIN_S = 0.05
"""After so long an interrupt that was dropped comes again [s]."""

_LOADING = "loading, and reading the headers of the inputs"
_STOPPING = "stopping"
_CONTINUES = frozenset({"run", "quickstart", "compare", "denoise"})
"""Commands that go on where they stopped."""

_STAGES = "index, shots, shuffle, denoise, ground, surfaces, deliver, report"


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
@click.argument("folder", type=click.Path(path_type=Path), default=Path("spl-quickstart"))
@limits
def quickstart(folder: Path, workers: int, memory: str | None) -> int:
    """Simulate a small survey into FOLDER and run the whole chain on it."""
    from spl_batch import api  # noqa: PLC0415 - heavy imports stay out of --help
    from spl_batch.cli import screen  # noqa: PLC0415
    from spl_batch.cli.watching import watching  # noqa: PLC0415

    with watching() as view:
        result = api.quickstart(
            folder,
            workers=workers,
            memory=memory,
            progress=view.simulated,
            listener=view.on_event,
        )
    screen.print_result(result, CLOCK.get().took_s)
    return result.exit_status


@cli.command()
@click.argument("scene", type=click.Path(path_type=Path))
@OUTPUT
def simulate(scene: Path, output: Path) -> int:
    """Fly a synthetic survey of SCENE into OUTPUT, with truth for every point."""
    from spl_batch import api  # noqa: PLC0415
    from spl_batch.cli import screen  # noqa: PLC0415
    from spl_batch.cli.watching import watching  # noqa: PLC0415

    with watching() as view:
        summary = api.simulate(scene, output, progress=view.simulated)
    screen.print_simulation(summary, output)
    return 0


@cli.command()
@WORKFLOW
@limits
@SETTINGS
@document.option
def plan(
    workflow: Path,
    workers: int,
    memory: str | None,
    overrides: tuple[str, ...],
    as_json: bool,  # noqa: FBT001 - click passes flags by name
) -> int:
    """Say what a run of WORKFLOW would do, and what is wrong with its inputs."""
    with saying_if_slow(_LOADING):
        from spl_batch import api  # noqa: PLC0415
        from spl_batch.cli import screen  # noqa: PLC0415

        summary = api.plan(workflow, workers=workers, memory=memory, overrides=overrides)
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
@click.option("--verify", is_flag=True, help="Compare all that is finished with its checksum.")
@click.option(
    "--until", metavar="STAGE", help=f"Stop after this stage; of an airborne survey: {_STAGES}."
)
@click.option(
    "--only",
    metavar="'KIND NAME'",
    help="Do one task alone, here, from what is finished; says where its traceback is.",
)
@SETTINGS
@document.option
def run(
    workflow: Path,
    workers: int,
    memory: str | None,
    scheduler: str | None,
    fresh: bool,  # noqa: FBT001 - click passes flags by name
    verify: bool,  # noqa: FBT001
    until: str | None,
    only: str | None,
    overrides: tuple[str, ...],
    as_json: bool,  # noqa: FBT001
) -> int:
    """Process the survey of WORKFLOW; run again, it continues where it stopped."""
    with saying_if_slow(_LOADING) as begun:
        from spl_batch import api  # noqa: PLC0415
        from spl_batch.cli import screen  # noqa: PLC0415
        from spl_batch.cli.watching import watching  # noqa: PLC0415

        if only is not None:
            if scheduler or fresh or verify or until or as_json:
                raise click.UsageError("--only goes with --workers, --memory and --set alone")
            alone = api.run_alone(
                workflow, only, workers=workers, memory=memory, overrides=overrides
            )
            screen.print_alone(alone)
            return alone.exit_status
        with watching() as view:

            def listen(event: Any) -> None:
                begun()
                view.on_event(event)

            result = api.run(
                workflow,
                workers=workers,
                memory=memory,
                scheduler=scheduler,
                fresh=fresh,
                verify=verify,
                until=until,
                overrides=overrides,
                listener=listen,
            )
    if as_json:
        document.print_document(document.of_result(result))
    else:
        screen.print_result(result, CLOCK.get().took_s)
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
def compare(
    workflow: Path, methods: str, workers: int, memory: str | None, overrides: tuple[str, ...]
) -> int:
    """Run several methods on the inputs of WORKFLOW: a table, and profiles side by side."""
    from spl_batch import api  # noqa: PLC0415
    from spl_batch.cli import screen  # noqa: PLC0415
    from spl_batch.cli.watching import watching  # noqa: PLC0415

    with watching() as view:
        result = api.compare(
            workflow,
            methods,
            workers=workers,
            memory=memory,
            overrides=overrides,
            listener=view.on_event,
        )
    screen.print_comparison(result)
    return result.exit_status


@cli.command()
@OUTPUT
@click.option(
    "--watch", is_flag=True, help="Show it until the run ends; wait for one that has not begun."
)
@document.option
def status(output: Path, watch: bool, as_json: bool) -> int:  # noqa: FBT001 - click passes flags by name
    """Say what is done, running, failed and left in OUTPUT, also while a run works there."""
    from spl_batch import api  # noqa: PLC0415
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
    with saying_if_slow("writing the report"):
        from spl_batch import api  # noqa: PLC0415
        from spl_batch.cli import screen  # noqa: PLC0415

        result = api.report(output)
    screen.print_result(result)
    return int(result.exit_status)


cli.add_command(denoise)
cli.add_command(init)


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
    told = threading.Event()
    given = sys.argv[1:] if arguments is None else arguments
    goes_on = bool(given) and given[0] in _CONTINUES
    interrupted = "interrupted" + "; the same command continues" * goes_on
    # As the command of its process it began with that: loading Python and packages counts.
    CLOCK.set(CommandClock(process_age_s() if arguments is None else 0.0))
    document.ASKED.set("--json" in given)  # options may not be read as far as that
    try:
        with _ended_in_order(told, _STOPPING + "; what is finished is kept" * goes_on):
            status = cli.main(args=arguments, prog_name="spl-batch", standalone_mode=False)
    except click.ClickException as error:
        _say_usage(error)
        if document.ASKED.get():
            document.print_error(error.format_message(), 2)
        sys.exit(2)
    except click.Abort:
        _end(interrupted, 3)
    except SplBatchError as error:
        _end(f"spl-batch: {error}", error.exit_status)
    except TimeoutError as error:
        said = str(error) or "no answer in time"
        _end(f"spl-batch: {said}; the machine is busy, run again to continue", 3)
    except OSError as error:
        full = error.errno in {errno.ENOSPC, errno.EDQUOT}
        remedy = "free some space and run again" if full else ""
        _end(f"spl-batch: {told_by_system(error, remedy)}", 3 if full else 2)
    except Exception:
        # The interrupt may come up as something else: in a callback of a compiler it is lost.
        if not told.is_set():
            raise
        _end(interrupted, 3)
    status = status if isinstance(status, int) else 0
    if arguments is None:
        _leave(status)
    sys.exit(status)


def _leave(status: int) -> None:
    """End this process at once: what is at work ends, what is written is flushed.

    Python would take apart every module that it has loaded, which takes a second; the system does
    that in no time. Where a thread or a profiler is still at work, or nobody
    reads on, Python ends as usual.
    """
    others = [t for t in threading.enumerate() if t is not threading.current_thread()]
    if sys.getprofile() or sys.gettrace() or not all(thread.daemon for thread in others):
        return
    atexit._run_exitfuncs()  # noqa: SLF001 - as multiprocessing does before os._exit
    try:
        for stream in (sys.stdout, sys.stderr):
            if stream is not None:  # as it is where it was closed before the start
                stream.flush()
    except (OSError, ValueError):  # of a pipe that is closed
        return
    os._exit(status)


def _say_usage(error: click.ClickException) -> None:
    """Say what is wrong with a command line, as click does, in short lines."""
    shown = io.StringIO()
    error.show(shown)
    for line in shown.getvalue().splitlines():
        say_error(line)


def _end(text: str, status: int) -> NoReturn:
    """Say why the command ends, and end it."""
    say_error(text)
    if document.ASKED.get():
        document.print_error(text, status)
    sys.exit(status)


@contextmanager
def _ended_in_order(told: threading.Event, saying: str) -> Iterator[None]:
    """Take the end of a queue system's time like Ctrl-C: in order, to be continued.

    Sets ``told`` when either comes, and says so.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return

    def interrupt(*_: object) -> None:
        if not told.is_set():
            # Nothing else may write here: the interrupt may have come amid a line of the console.
            for show in DRAWN:
                show(saying)
            with suppress(OSError):  # of a terminal that is gone
                os.write(2, b"" if DRAWN else f"\n{saying}\n".encode())
        told.set()
        raise KeyboardInterrupt

    def unraisable(found: Any) -> None:
        # Raised in a destructor or a callback, where Python drops it: it comes again.
        if told.is_set() and isinstance(found.exc_value, KeyboardInterrupt):
            again = threading.Timer(_AGAIN_S, _thread.interrupt_main, [signal.SIGTERM])
            again.daemon = True
            again.start()
        else:
            hook(found)

    def uncaught(kind: type[BaseException], value: BaseException, trace: Any) -> None:
        # Callbacks of compiled libraries print what they drop, as if the program ended with it.
        if not (told.is_set() and issubclass(kind, KeyboardInterrupt)):
            shown(kind, value, trace)

    before = {
        sign: signal.signal(sign, interrupt)
        for sign in (signal.SIGTERM, signal.SIGINT)
        if signal.getsignal(sign) != signal.SIG_IGN  # of a command in the background
    }
    hook, sys.unraisablehook = sys.unraisablehook, unraisable
    shown, sys.excepthook = sys.excepthook, uncaught
    try:
        yield
    finally:
        sys.unraisablehook, sys.excepthook = hook, shown
        for sign, handler in before.items():
            signal.signal(sign, handler)
