"""The options that several commands take, declared once.

A command takes a group of options as one argument, whose type is a dataclass: `on_command_line` declares each field as
an option, and gives the command the object.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable
from dataclasses import dataclass, fields, is_dataclass
from pathlib import Path
from typing import Annotated, Any, cast, get_type_hints

import typer

from hapsim.cli.output import say
from hapsim.errors import UsageError

SceneFile = Annotated[str, typer.Argument(metavar="SCENE", help="A scene in YAML, such as configs/first_touch.yaml.")]
Json = Annotated[bool, typer.Option("--json", help="Print one JSON document on standard output, nothing else there.")]
Port = Annotated[str | None, typer.Option(metavar="P", help="The device's serial port, in place of the scene's.")]
MockFlag = Annotated[bool, typer.Option("--mock", help="Use the built-in mock even if the scene names a port.")]
Realtime = Annotated[
    bool,
    typer.Option(
        "--realtime",
        help="Request real-time scheduling, locked memory and no CPU idle states; report what was granted.",
    ),
]
Unstable = Annotated[
    bool, typer.Option("--unstable", help="Run even a scene that is predicted unstable: the device will oscillate.")
]
PictureFile = Annotated[Path | None, typer.Option("--picture", metavar="FILE", help="Draw it: .svg, .png or .pdf.")]
DataFile = Annotated[Path | None, typer.Option("--data", metavar="FILE.csv", help="Write the numbers of the picture.")]
Baud = Annotated[int, typer.Option(min=1, max=100_000_000, metavar="B", help="Baud rate of the device's port, bit/s.")]


def _above_zero(value: float | None) -> float | None:
    if value is not None and not 0 < value < float("inf"):
        raise UsageError(f"--duration: found {value:g}, expected a finite number of seconds above 0")
    return value


def seconds(text: str) -> Any:
    """Returns the declaration of `--duration`, a finite number of seconds above 0."""
    return typer.Option(metavar="S", callback=_above_zero, help=text)


@dataclass
class DeviceOptions:
    """Where the device of a scene is: at a port, or the mock."""

    scene: SceneFile
    port: Port = None
    mock: MockFlag = False
    transport: Annotated[
        str | None, typer.Option(metavar="KIND", help="Where the mock runs: loopback (in memory) or terminal.")
    ] = None

    def load(self) -> Any:
        """Returns the scene, with the port that the options name. Raises SceneError."""
        return load(self.scene, self.port)

    def kind(self) -> Any:
        """Returns the TransportKind. Raises UsageError where the options contradict each other."""
        return transport_kind(self.mock, self.transport, self.port)


@dataclass
class RecordOptions:
    """The file that a trace is written to."""

    record: Annotated[Path | None, typer.Option(metavar="FILE", help="Write the trace: .trace, .npz or .csv.")] = None
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace the file of --record if it exists.")] = False

    def require_writable(self) -> None:
        """Raises UsageError where the file cannot be written, or exists and is not to be replaced."""
        if self.record is None:
            return
        from hapsim.recording.trace import require_writable_as_trace

        require_writable_as_trace(self.record)
        if self.record.is_file() and not self.overwrite:
            raise UsageError(f"{self.record}: the file exists; --overwrite replaces it")


def load(path: str, port: str | None = None) -> Any:
    """Returns the Scene of a file, on `port` if one is given. Raises SceneError."""
    from hapsim.scene import load_scene

    scene = load_scene(path)
    return (
        scene if port is None else scene.model_copy(update={"device": scene.device.model_copy(update={"port": port})})
    )


def transport_kind(mock: bool, transport: str | None, port: str | None) -> Any:
    """Returns the TransportKind that three options name. Raises UsageError where they contradict each other."""
    if port is not None and (mock or transport is not None):
        raise UsageError("--port names a device, --mock and --transport the mock: found both, expected one of them")
    if transport is not None and transport not in ("loopback", "terminal"):
        raise UsageError(f"--transport: found '{transport}', expected loopback or terminal")
    return transport or ("mock" if mock else "auto")


def names(words: list[str] | None) -> list[str]:
    """Returns the words of an option that may be repeated, and may hold several words with commas between them."""
    return ",".join(words).split(",") if words else []


def numbers(option: str, words: list[str] | None) -> list[float]:
    """Returns the numbers of such an option, sorted, each once. Raises UsageError."""
    found = set()
    for word in names(words):
        try:
            found.add(float(word))
        except ValueError:
            raise UsageError(
                f"{option}: found '{word}', expected a number, or several with commas between them"
            ) from None
    return sorted(found)


def require_drawable(picture: Path | None, data: Path | None) -> None:
    """Raises UsageError where a picture or its numbers cannot be written: before a run, not after it."""
    if picture is not None or data is not None:
        from hapsim.chart.figure import require_writable

        require_writable(picture)
        require_writable(data, (".csv",))


def say_written(picture: Path | None = None, data: Path | None = None, record: Path | None = None) -> None:
    """Prints which files were written."""
    for what, path in (("Picture", picture), ("Its numbers", data), ("Trace", record)):
        if path is not None:
            say(f"{what}: {path}")


def on_command_line(command: Callable[..., None]) -> Callable[..., None]:
    """Returns `command` as typer takes it: arguments that are dataclasses are spread into options, and the docstring
    has one line for each paragraph, which typer then breaks where the terminal ends."""
    groups: dict[str, tuple[type, list[str]]] = {}
    declared = []
    for parameter in inspect.signature(command, eval_str=True).parameters.values():
        if not is_dataclass(parameter.annotation):
            declared.append(parameter.replace(kind=inspect.Parameter.KEYWORD_ONLY))
            continue
        group = cast(type, parameter.annotation)
        hints = get_type_hints(group, include_extras=True)
        groups[parameter.name] = group, [field.name for field in fields(group)]
        declared += [
            inspect.Parameter(
                name, inspect.Parameter.KEYWORD_ONLY, default=getattr(group, name, inspect.Parameter.empty)
            ).replace(annotation=hints[name])
            for name in groups[parameter.name][1]
        ]

    def call(**given: Any) -> None:
        for name, (group, members) in groups.items():
            given[name] = group(**{member: given.pop(member) for member in members})
        command(**given)

    for parameter in declared:
        for option in getattr(parameter.annotation, "__metadata__", ()):
            option.help = (option.help or "").replace(" [default:", r" \[default:")  # or rich takes it for a style
    paragraphs = inspect.cleandoc(command.__doc__ or "").split("\n\n")
    call.__doc__ = "\n\n".join(" ".join(paragraph.splitlines()) for paragraph in paragraphs)
    call.__signature__ = inspect.Signature(declared)  # type: ignore[attr-defined]
    call.__annotations__ = {parameter.name: parameter.annotation for parameter in declared}
    return call
