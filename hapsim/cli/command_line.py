"""The command line: which commands there are, and how each ends: a sentence and an exit status.

A command's file is loaded when the command is called: `hapsim --help` and the start of each command stay quick.
"""

from __future__ import annotations

import errno
import importlib
import os
import platform
import sys
from importlib import metadata
from typing import Annotated, Any, ClassVar

import typer
from typer.core import TyperCommand, TyperGroup

from hapsim.cli.options import on_command_line
from hapsim.cli.output import complain, use_sentences
from hapsim.cli.streams import output_failure, standing_streams
from hapsim.errors import HapsimError, UsageError
from hapsim.stopping import end_interrupted, was_interrupted

_DEFECT, _WRONG_COMMAND_LINE = 1, 2


class _Commands(TyperGroup):
    """A group whose commands are loaded when they are called."""

    table: ClassVar[dict[str, tuple[str, str]]] = {}
    """Of each command: module and function, and the first line of its help."""

    def list_commands(self, ctx: Any) -> list[str]:
        return [*self.table, *super().list_commands(ctx)]

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        if cmd_name in self.table:
            return TyperCommand(cmd_name, help=self.table[cmd_name][1])  # enough for the list in --help
        return super().get_command(ctx, cmd_name)

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        name, command, rest = super().resolve_command(ctx, args)
        return name, self._loaded(name) if name in self.table else command, rest

    def _loaded(self, name: str) -> Any:
        module, _, function = self.table[name][0].partition(":")
        app = typer.Typer(add_completion=False, pretty_exceptions_enable=False)
        app.command(name)(on_command_line(getattr(importlib.import_module(module), function)))
        return typer.main.get_command(app)


class Commands(_Commands):
    """The commands `hapsim …`."""

    table: ClassVar[dict[str, tuple[str, str]]] = {
        "run": ("hapsim.cli.run:run", "Run a scene with its device, or with the built-in mock."),
        "status": ("hapsim.cli.status:status", "Show the status of a running hapsim."),
        "service": ("hapsim.cli.prepare:service", "Print a systemd unit that runs a scene."),
        "check": (
            "hapsim.cli.check:check",
            "Predict without running: stability, what the hand feels, gain margins, the wire.",
        ),
        "measure": ("hapsim.cli.measure:measure", "Measure what the hand feels, and compare it with the prediction."),
        "identify": (
            "hapsim.cli.identify:identify",
            "Push the device and identify its mass, friction, spring, delay and dry friction.",
        ),
        "doctor": ("hapsim.cli.doctor:doctor", "Examine how steady this machine is for a haptic loop."),
        "probe": ("hapsim.cli.probe:probe", "Test a device's firmware against the protocol, check by check."),
        "frames": ("hapsim.cli.frames:frames", "Decode the frames of a capture, a report file or a serial port."),
        "faults": ("hapsim.cli.faults:faults", "Inject faults: relay between host and device and apply a script."),
        "mock": ("hapsim.cli.device:mock", "Serve a scene's mock device on a pseudo-terminal."),
        "compile": ("hapsim.cli.prepare:compile_", "Compile ahead of the first run. No device is touched."),
        "ports": ("hapsim.cli.device:ports", "List the serial ports."),
        "new": ("hapsim.cli.prepare:new", "Write a first scene to begin with."),
        "schema": ("hapsim.cli.prepare:schema", "Print the JSON schema of scenes, for editors."),
    }


class ChartCommands(_Commands):
    """The commands `hapsim chart …`."""

    table: ClassVar[dict[str, tuple[str, str]]] = {
        "plane": (
            "hapsim.cli.chart_plane:plane",
            "Draw the K,B plane: curves of equal k and b that the hand feels.",
        ),
        "transparency": (
            "hapsim.cli.chart_transparency:transparency",
            "Draw the rendered impedance beside the desired one, over frequency.",
        ),
        "table1": (
            "hapsim.cli.chart_table1:table1",
            "Couple the hand's mass with real and simulated springs, predicted and measured.",
        ),
        "speed-accuracy": (
            "hapsim.cli.chart_speed_accuracy:speed_accuracy",
            "Draw the cost of a simulated second against the error: objects, schemes, rates.",
        ),
        "felt": (
            "hapsim.cli.chart_felt:felt",
            "Draw which desired stiffness and damping the hand feels, with each correction.",
        ),
        "trace": ("hapsim.cli.chart_trace:trace", "Draw a recorded trace: position and force over time."),
    }


_HELP_OPTIONS = {"help_option_names": ["-h", "--help"]}

app = typer.Typer(
    name="hapsim",
    cls=Commands,
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    context_settings=_HELP_OPTIONS,
)
app.add_typer(
    typer.Typer(
        name="chart",
        cls=ChartCommands,
        help="Draw what the hand feels, and write the numbers drawn.",
        no_args_is_help=True,
        callback=lambda: None,
    )
)


def _print_version(wanted: bool) -> None:
    """Prints the versions of everything that decides what hapsim does, without importing numba or numpy."""
    if not wanted:
        return
    import hapsim
    from firmware_protocol import schema

    print(f"hapsim {hapsim.__version__}")
    print(f"wire protocol {schema.VERSION}, schema 0x{schema.SCHEMA_HASH:08x}")
    print(f"Python {platform.python_version()} ({platform.python_implementation()})")
    for package in ("numba", "numpy"):
        try:
            print(f"{package} {metadata.version(package)}")
        except metadata.PackageNotFoundError:
            print(f"{package} not installed")
    print(f"platform {platform.platform()}")
    raise typer.Exit()


@app.callback()
def _about_hapsim(
    version: Annotated[
        bool,
        typer.Option("--version", is_eager=True, callback=_print_version, help="Print what a bug report needs."),
    ] = False,
) -> None:
    """A real-time haptic simulator that predicts and measures the stiffness and damping the hand really feels."""


def run_command() -> int:
    """Runs what `sys.argv` asks for, and returns the exit status."""
    with standing_streams():
        use_sentences()
        status = _run_app()
        use_sentences()  # writes what a log still has
        failure = output_failure()
        if failure is not None:
            status = _fail(f"hapsim: the output cannot be written: {failure.strerror}", UsageError.exit_status)
    if "hapsim.loop.realtime.giving_way" in sys.modules:
        sys.modules["hapsim.loop.realtime.giving_way"].leave_unfinished(status)
    return status


def _run_app() -> int:
    try:
        app()
    except KeyboardInterrupt:
        return end_interrupted()
    except HapsimError as error:
        return _fail(str(error), error.exit_status)
    except SystemExit as ending:
        if was_interrupted():
            return end_interrupted()
        # Typer has printed what is wrong with the command line; a command that ends by itself has printed all.
        if ending.code == _WRONG_COMMAND_LINE and not isinstance(ending.__context__, typer.Exit):
            _print_failure("the command line was not understood; standard error says why", _WRONG_COMMAND_LINE)
        return int(ending.code or 0)
    except Exception as error:
        if was_interrupted():
            return end_interrupted()
        if isinstance(error, OSError) and error.errno in (errno.ENOSPC, errno.EDQUOT):
            return _fail(f"hapsim: the output cannot be written: {error.strerror}", UsageError.exit_status)
        if os.environ.get("HAPSIM_TRACEBACK"):
            raise
        return _fail(
            f"hapsim: a defect of hapsim itself: {type(error).__name__}: {error}\n"
            "Please report it; HAPSIM_TRACEBACK=1 in the environment prints where.",
            _DEFECT,
        )
    return 0


def _fail(problem: str, status: int) -> int:
    complain(problem)
    _print_failure(problem, status)
    return status


def _print_failure(problem: str, status: int) -> None:
    if "--json" in sys.argv:
        from hapsim.cli.as_json import document

        print(document({"error": problem, "exit_status": status}))
