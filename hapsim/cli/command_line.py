"""The command line: the commands, and their ends as a sentence and an exit status.

A command's file is loaded when the command is called: `hapsim --help` and the start of each command stay quick.
"""

from __future__ import annotations

import errno
import gc
import importlib
import inspect
import os
import re
import sys
from collections.abc import Callable, Iterable
from functools import cache
from pathlib import Path
from typing import Annotated, Any, ClassVar

import typer
from typer.core import TyperCommand, TyperGroup

from hapsim.cli.command_options import choose_cache, on_command_line, take_cache
from hapsim.cli.output import document, log_as_json, print_message, set_output_units
from hapsim.cli.streams import output_failure, resilient_streams
from hapsim.errors import HapsimError, UsageError, refused_by_system
from hapsim.scene.issue import as_argument
from hapsim.scene.shipped import shipped_boards, shipped_scenes, shipped_scripts
from hapsim.stopping import end_interrupted, was_interrupted
from hapsim.units import LINEAR


class _Commands(TyperGroup):
    """A group whose commands are loaded when they are called."""

    table: ClassVar[dict[str, tuple[str, str]]] = {}
    """Commands by name: (module:function, first line of the help)."""

    def __init__(self, **attributes: Any) -> None:
        super().__init__(**attributes)
        listed = {name: TyperCommand(name, help=text) for name, (_, text) in self.table.items()}
        self.commands = listed | dict(self.commands)  # enough for --help, and for suggesting the nearest name

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        """Returns (name, command, words behind it) of `args`. Imports the command's module, unless a shell completes
        it, and obeys `--cache DIR` before that."""
        name, command, rest = super().resolve_command(ctx, args)
        if not ctx.resilient_parsing:  # completion
            rest = take_cache(rest)  # the command's module decides where compiled code is
        if name not in self.table:
            return name, command, rest
        return name, outline(f"{ctx.command_path} {name}") if ctx.resilient_parsing else self._loaded(name), rest

    def _loaded(self, name: str) -> Any:
        module, _, function = self.table[name][0].partition(":")
        command = getattr(importlib.import_module(f"hapsim.cli.{module}"), function)
        _set_imports_aside()
        gc.enable()
        app = typer.Typer(add_completion=False, pretty_exceptions_enable=False)
        app.command(name)(on_command_line(command))
        return typer.main.get_command(app)


@cache
def _set_imports_aside() -> None:
    """Spares collections of garbage all that was imported: it stays."""
    gc.freeze()


def outline(path: str) -> Any:
    """Returns a command, such as "hapsim run", for a shell's completion only. Its options come from the manual page, so
    that nothing heavy is imported."""
    page = Path(__file__).parents[1].joinpath("hapsim.1").read_text("utf-8").replace("\\-", "-")
    section = page.partition(f".SS {path} [OPTIONS]")[2].partition("\n.S")[0]
    declared = []
    for i, (entry, text) in enumerate(re.findall(r"^\.TP\n(.*)\n(.*)$", section, re.MULTILINE)):
        options, value = re.findall(r"\\fB(.*?)\\fR", entry), "".join(re.findall(r"\\fI(.*?)\\fR", entry))
        kinds = [*options, *re.findall("[A-Z]+", value)]
        words = next((_WORDS[kind] for kind in kinds if kind in _WORDS), None)
        declaring: Any = typer.Option if options else typer.Argument
        kind: Any = (list[str] if "…" in value else str) | None if value else bool
        annotation: Any = Annotated[kind, declaring(*options, help=text, autocompletion=words)]
        one = inspect.Parameter(f"_{i}", inspect.Parameter.KEYWORD_ONLY, default=None if value else False)
        declared.append(one.replace(annotation=annotation))

    def call(**_: Any) -> None: ...

    call.__signature__ = inspect.Signature(declared)  # type: ignore[attr-defined]
    call.__annotations__ = {parameter.name: parameter.annotation for parameter in declared}
    app = typer.Typer(add_completion=False)
    app.command()(call)
    return typer.main.get_command(app)


def _offered(words: Callable[[], Iterable[str]], ending: str = "") -> Callable[[str], list[str]]:
    """Returns a completion of `words` and of files in this directory. If none fits, shells offer files."""

    def complete(incomplete: str) -> list[str]:
        files = [as_argument(path.name) for path in Path().glob(f"*{ending}")] if ending else []
        return sorted({word for word in (*files, *words()) if word.startswith(incomplete)})

    return complete


def _ports() -> list[str]:
    from serial.tools import list_ports

    return [port.device for port in list_ports.comports()]


_WORDS = {
    "--from": _offered(shipped_scenes),
    "--board": _offered(shipped_boards),
    "SCENE": _offered(shipped_scenes, ".yaml"),
    "SCRIPT": _offered(shipped_scripts, ".yaml"),
    "PORT": (_of_port := _offered(_ports)),
    "--port": _of_port,
}
"""Completion of an option or a value, by its name in the help."""


class Commands(_Commands):
    """The commands `hapsim …`."""

    table: ClassVar[dict[str, tuple[str, str]]] = {
        "run": ("run_command:run", "Run a scene with its device, or with the built-in mock."),
        "status": ("status_command:status", "Show the status of a running hapsim."),
        "service": ("prepare:service", "Print a systemd unit that runs a scene."),
        "check": ("check:check", "Predict stability, gain margins, and the stiffness and damping that the hand feels."),
        "measure": ("measure_command:measure", "Measure what the hand feels, and compare with the prediction."),
        "identify": (
            "identify:identify",
            "Push the device, and identify its mass, spring, delay, viscous and dry friction.",
        ),
        "doctor": ("doctor:doctor", "Measure the wake-up latency and the possible loop rates of this machine."),
        "couple": ("couple:couple", "Choose a virtual coupling that keeps any hand stable, whatever the scene."),
        "curve": ("curve:curve", "Make the curve of a link, and a scene, from a recording of force over distance."),
        "probe": ("probe:probe", "Test a device's firmware against the protocol, check by check."),
        "replay": ("records:replay", "Replay a record through its scene or another one. No device is used."),
        "export": ("records:export", "Write a record for other programs: HDF5, MCAP, CSV, NumPy or sound."),
        "sweep": ("sweep_command:sweep", "Predict and measure a scene over ranges of its parameters."),
        "frames": ("frames_command:frames", "Decode the frames of a capture, a report file or a serial port."),
        "faults": ("faults:faults", "Inject faults: relay between host and device and apply a script."),
        "mock": ("device_commands:mock", "Serve a scene's mock device on a pseudo-terminal."),
        "compile": ("prepare:compile_", "Compile ahead of the first run. No device is touched."),
        "ports": ("device_commands:ports", "List the serial ports."),
        "sound": ("device_commands:sound", "List the sound cards that `run --sound` can play on."),
        "new": ("prepare:new", "Write a scene file to start from."),
        "scenes": ("prepare:scenes", "List the scenes that ship with hapsim."),
        "files": ("prepare:files", "Print the paths of the C header, the firmware, the pages and the scenes."),
        "schema": ("prepare:schema", "Print the JSON schema of scenes, for editors."),
    }


class ChartCommands(_Commands):
    """The commands `hapsim chart …`."""

    table: ClassVar[dict[str, tuple[str, str]]] = {
        "plane": ("chart_hand:plane", "Draw the K,B plane: contours of the k and b that the hand feels."),
        "force": ("chart_hand:force", "Draw force over displacement, with the felt stiffness."),
        "transparency": ("chart_hand:transparency", "Draw rendered and desired impedance over frequency."),
        "table1": ("chart_runs:table1", "Draw Table 1 of the paper: a mass on real and simulated springs."),
        "speed-accuracy": ("chart_runs:speed_accuracy", "Draw computing time against error."),
        "felt": ("chart_hand:felt", "Draw the desired stiffness and damping that the hand can feel."),
        "trace": ("chart_runs:trace", "Draw a recorded trace: position and force over time."),
    }


_HELP_OPTIONS = {"help_option_names": ["-h", "--help"]}

app = typer.Typer(
    name="hapsim", cls=Commands, no_args_is_help=True, pretty_exceptions_enable=False, context_settings=_HELP_OPTIONS
)
app.add_typer(
    typer.Typer(
        name="chart",
        cls=ChartCommands,
        help="Draw charts of what the hand feels, and write their numbers.",
        no_args_is_help=True,
        callback=lambda: None,
    )
)


def _print_version(wanted: bool) -> None:
    """Prints the versions of hapsim, its protocol and its libraries, without importing numba or numpy."""
    if not wanted:
        return
    import platform
    from importlib import metadata

    import hapsim
    from firmware_protocol import schema

    print(f"hapsim {hapsim.__version__}")
    print(f"wire protocol {schema.VERSION}, schema 0x{schema.SCHEMA_HASH:08x}")
    print(f"Python {platform.python_version()} ({platform.python_implementation()})")
    for package in ("numba", "numpy"):
        print(f"{package} {metadata.version(package)}")
    print(f"platform {platform.platform()}")
    raise typer.Exit()


@app.callback()
def _about_hapsim(
    version: Annotated[
        bool,
        typer.Option(
            "--version", is_eager=True, callback=_print_version, help="Print the versions that a bug report needs."
        ),
    ] = False,
    cache: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR",
            callback=choose_cache,
            help=r"Directory for compiled code, also after the command \[default: HAPSIM_CACHE, or ~/.cache/hapsim]",
        ),
    ] = None,
) -> None:
    """A real-time haptic simulator that predicts and measures the stiffness and damping the hand really feels."""


def run_command() -> int:
    """Runs the command in `sys.argv`, and returns the exit status."""
    if os.environ.get("COLUMNS", "").strip("0") == "":
        os.environ.pop("COLUMNS", None)  # a terminal of unknown width reports 0, at which nothing would be printed
    with resilient_streams():
        log_as_json(False)
        set_output_units(LINEAR)
        ended = _run_app()
        log_as_json(False)  # writes what a log still has
        # A disk that a command found full may be the output's, too: that is one sentence.
        status, failure = (ended, output_failure()) if isinstance(ended, int) else (0, ended)
        if failure is not None:
            status = _fail(f"hapsim: the output cannot be written: {failure.strerror}", UsageError.exit_status)
    if "hapsim.loop.background" in sys.modules:
        sys.modules["hapsim.loop.background"].exit_with_unfinished(status)
    return status


def _run_app() -> int | OSError:
    """Returns the exit status, or the error of a disk that is full."""
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
        if ending.code == UsageError.exit_status and not isinstance(ending.__context__, typer.Exit):
            wrong = getattr(
                ending.__context__, "format_message", lambda: "the command line is wrong: see standard error"
            )
            _print_failure(wrong(), UsageError.exit_status)
        return int(ending.code or 0)
    except Exception as error:
        if was_interrupted():
            return end_interrupted()
        if isinstance(error, OSError) and error.errno in (errno.ENOSPC, errno.EDQUOT):
            return error
        if os.environ.get("HAPSIM_TRACEBACK"):
            raise
        if refusal := refused_by_system(error):
            return _fail(f"hapsim: {refusal}", UsageError.exit_status)
        return _fail(
            f"hapsim: a defect of hapsim itself: {type(error).__name__}: {error}\n"
            "Please report it; HAPSIM_TRACEBACK=1 in the environment prints where.",
            HapsimError.exit_status,
        )
    return 0


def _fail(problem: str, status: int) -> int:
    print_message(problem)
    _print_failure(problem, status)
    return status


def _print_failure(problem: str, status: int) -> None:
    if "--json" in sys.argv:
        print(document({"error": problem, "exit_status": status}))
