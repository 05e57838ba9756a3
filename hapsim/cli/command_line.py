"""The command line: which commands there are, and how each ends: a sentence and an exit status."""

from __future__ import annotations

import io
import os
import sys
from collections.abc import Callable
from typing import Annotated, NoReturn

import typer

from hapsim.cli.chart import app as chart
from hapsim.cli.check import check
from hapsim.cli.device import mock, ports
from hapsim.cli.doctor import doctor
from hapsim.cli.faults import faults
from hapsim.cli.frames import frames
from hapsim.cli.guarded_output import guarded_output, is_full
from hapsim.cli.help_text import help_text
from hapsim.cli.identify import identify
from hapsim.cli.log import complain, use_sentences
from hapsim.cli.measure import measure
from hapsim.cli.prepare import compile_, new, schema
from hapsim.cli.probe import probe
from hapsim.cli.run import run
from hapsim.cli.service import service
from hapsim.cli.standard_streams import standing_streams
from hapsim.cli.status import status
from hapsim.errors import HapsimError
from hapsim.stopping import INTERRUPTED, pass_over, sentence, was_interrupted
from hapsim.stopping import document as document_of_it

_WRONG_COMMAND_LINE = 2

app = typer.Typer(
    name="hapsim",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)
for _command in (
    run,
    status,
    service,
    check,
    measure,
    identify,
    doctor,
    probe,
    frames,
    faults,
    mock,
    compile_,
    ports,
    new,
    schema,
):
    app.command(_command.__name__.rstrip("_"), help=help_text(_command))(_command)
app.add_typer(chart)


def _print_version(wanted: bool) -> None:
    if wanted:
        from hapsim.cli.version import version_lines

        print("\n".join(version_lines()))
        raise typer.Exit()


@app.callback()
def _about_hapsim(
    version: Annotated[
        bool,
        typer.Option(
            "--version",
            is_eager=True,
            callback=_print_version,
            help="Print what a bug report needs.",
        ),
    ] = False,
) -> None:
    """A real-time haptic simulator that tells what stiffness and damping the hand really feels."""


@guarded_output()
def run_command(ready: Callable[[], None]) -> None:
    """Runs what `sys.argv` asks for; `ready` is called once an interrupt may come as an exception."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="replace")  # a terminal that cannot show a character shows another
    with standing_streams():
        use_sentences()
        try:
            try:
                ready()
                _run_app()
            except KeyboardInterrupt:  # where typer does not hear it
                _end_interrupted()
        finally:
            use_sentences()  # what a log left out is said at its end


def _run_app() -> None:
    try:
        app()
    except HapsimError as error:
        _fail(str(error), error.exit_status)
    except SystemExit as ending:
        _end_as_typer_does(ending)
    except Exception as error:
        if isinstance(error, BrokenPipeError) or is_full(error) or os.environ.get("HAPSIM_TRACEBACK"):
            raise
        if was_interrupted():
            _end_interrupted()
        _fail(
            f"hapsim: a defect of hapsim itself: {type(error).__name__}: {error}\n"
            "Please report it; with HAPSIM_TRACEBACK=1 in the environment it says where.",
            1,
        )


def _fail(problem: str, exit_status: int) -> NoReturn:
    complain(problem)
    if "--json" in sys.argv:
        _print_failure(problem, exit_status)
    sys.exit(exit_status)


def _end_interrupted() -> NoReturn:
    pass_over()
    # An interrupt that leaves an exec, as of a namedtuple in a module that is loaded, has `python -m` end by SIGINT,
    # whatever becomes of it after that; the next exec has it forget.
    exec("")
    complain(sentence())
    if "--json" in sys.argv:
        print(document_of_it())
    _leave(SystemExit(INTERRUPTED))


def _print_failure(problem: str, exit_status: int) -> None:
    from hapsim.cli.as_json import document

    print(document({"error": problem, "exit_status": exit_status}))


def _end_as_typer_does(ending: SystemExit) -> NoReturn:
    """Typer has said what it had to say: about a wrong command line, or nothing where a command has its own status."""
    exiting = ending.__context__
    of_its_own = isinstance(exiting, typer.Exit)
    if ending.code == _WRONG_COMMAND_LINE and "--json" in sys.argv and not of_its_own:
        _print_failure("the command line was not understood; standard error says why", ending.code)
    if isinstance(exiting, typer.Exit) and isinstance(exiting.__cause__, KeyboardInterrupt):
        _end_interrupted()  # typer has taken the interrupt, and says nothing
    _leave(ending)


def _leave(ending: SystemExit) -> NoReturn:
    if "hapsim.loop.realtime.giving_way" in sys.modules and isinstance(ending.code, int | None):
        sys.modules["hapsim.loop.realtime.giving_way"].leave_unfinished(ending.code or 0)
    raise ending
