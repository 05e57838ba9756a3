"""Options of several commands, declared once.

A command takes a group of options as one argument, whose type is a dataclass: `on_command_line` declares each field as
an option, and gives the command the object.
"""

from __future__ import annotations

import contextlib
import inspect
import math
import os
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from copy import copy
from dataclasses import MISSING, Field, dataclass, field, fields, is_dataclass
from functools import partial
from pathlib import Path
from typing import Annotated, Any, cast, get_args, get_origin, get_type_hints

import typer

from hapsim.cli.output import output_units, print_line, set_output_units, use_channel_units, warn
from hapsim.errors import UsageError
from hapsim.number_format import listed
from hapsim.scene.issue import as_argument, command_line
from hapsim.stopping import note_interrupt
from hapsim.units import MOTIONS, Units

_STANDARD_INPUT, _AT = "-", "--at"
_TYPER, _UNIT = "typer", "unit"


def option(metavar: str | None, text: str, *names: str, default: Any = None, unit: str = "", **of_typer: Any) -> Any:
    """Returns the declaration of an option that takes a value, in place of its default: of a field of a dataclass, or
    of an argument of a command. It also stands in an Annotated that several commands share; the default then stands
    beside it. `default`: ... where it has to be given. `unit`: of a `Quantity`, as of a line, such as N/m. `of_typer`:
    further arguments of typer's Option."""
    declared = typer.Option(*names, metavar=metavar, help=text, **of_typer)
    return field(default=default, metadata={_TYPER: declared, _UNIT: unit})


def flag(name: str, text: str) -> Any:
    """Returns the declaration of an option without a value, likewise."""
    return option(None, text, name, default=False)


def argument(metavar: str | None, text: str, *, default: Any = None) -> Any:
    """Returns the declaration of a word of the command, likewise."""
    return field(default=default, metadata={_TYPER: typer.Argument(metavar=metavar, help=text)})


SceneFile = Annotated[
    str, argument("SCENE", "Scene file in YAML, name of a shipped scene, or - for standard input.", default=...)
]
_OF_DEVICE = "of_device"
Device = Annotated[
    str | None,
    option("NAME", "Device of a scene with several: it alone, with points of the others held still.", "--device"),
]
Json = Annotated[bool, flag("--json", "Print one JSON document, and nothing else, on standard output.")]
Port = Annotated[str | None, option("P", "Serial port of the device [default: the scene's]")]
MockFlag = Annotated[bool, flag("--mock", "Use the built-in mock even if the scene names a port.")]
Realtime = Annotated[
    bool,
    flag("--realtime", "Request real-time scheduling, locked memory and no CPU idle states; report what was granted."),
]
Unstable = Annotated[
    bool, flag("--unstable", "Run the scene even if it is predicted unstable. The device will oscillate.")
]
Watch = Annotated[bool, flag("--watch", "Apply changes of the scene file whenever it is saved.")]
Baud = Annotated[int, option("B", "Baud rate of the device's port, bit/s.", min=1, max=100_000_000)]


class Quantity(float):
    """The value of an option in SI units, and as it was written: bare, or with a unit of either motion."""

    option = text = unit = ""


At = Annotated[
    str | None,
    option(
        "X", "Position of the hand, such as 0.002 (m), 2mm or 15deg; with space: 2, X,Y [default: at equilibrium]", _AT
    ),
]


def quantity(option: str, text: str, unit: str, units: Units | None = None) -> Quantity:
    """Returns the value of an option. Raises ValueError if it is no number, UsageError if its unit does not fit.

    `unit`: of the option, as of a line, such as N/m. `units`: of its motion; None: either.
    """
    from hapsim.scene.written_units import QUANTITY, UnitError, in_si

    si = Units.of(MOTIONS) if units is None else units.si
    try:
        value = Quantity(in_si(text, unit, si.motions) if QUANTITY.match(text) else float(text))
    except UnitError as error:
        raise UsageError(f"{option}: found {error.found}, expected {si.filled(error.expected(unit))}") from None
    value.option, value.text, value.unit = option, text, unit
    return value


def require_units(units: Units, *given: object) -> None:
    """Raises UsageError where a Quantity among the values of options has a unit of another motion than `units`, is not
    finite, or is a bare number of m or rad that no hand reaches."""
    from hapsim.scene.written_units import QUANTITY

    for one in given:
        if not isinstance(one, Quantity):
            continue
        option, text, si = one.option, one.text, units.si.name("m")
        quantity(option, text, one.unit, units)
        if not math.isfinite(one):
            raise UsageError(f"{option}: found {text}, expected a finite number")
        if one.unit == "m" and si in _FAR and not QUANTITY.match(text):
            most, unit, meant = _FAR[si]
            if (abs(one) if option == _AT else one) >= most:
                likely = f"write {text}{unit} if you meant {meant}, or {text}{si}"
                raise UsageError(f"{option}: found {text}, which is {one:g} {si}; {likely}")


def require_positive(option: str, value: float | None, unit: str = "") -> float | None:
    """Returns the value of an option. Raises UsageError if it is given and not a finite number above 0."""
    if value is not None and not 0 < value < math.inf:
        of_unit = f" of {unit}" if unit else ""
        raise UsageError(f"{option}: found {value:g}, expected a finite number{of_unit} above 0")
    return value


def seconds(text: str) -> Any:
    """Returns the declaration of `--duration`, a finite number of seconds above 0."""
    return option("S", text, callback=lambda value: require_positive("--duration", value, "seconds"))


def push_option(*names: str) -> Any:
    """Returns the declaration of `--push`, with its aliases."""
    help_text = "Largest test push, such as 0.5 (N or N·m) or 50mN [default: a quarter of force_limit]"
    return option("N", help_text, "--push", *names, unit="N")


_FAR = {"m": (1.0, "mm", "mm"), "rad": (20.0, "deg", "degrees")}  # no hand reaches that; what was meant
_CACHE = "HAPSIM_CACHE"  # `firmware_protocol.code_cache`, which would import numba


def chosen_cache() -> Path | None:
    """Returns the directory for compiled code that --cache or the environment names."""
    chosen = os.environ.get(_CACHE)
    return Path(chosen) if chosen else None


def choose_cache(directory: Path | None) -> None:
    """Names the directory for compiled code, for this process and those that it starts."""
    if directory is not None:
        if directory.exists() and not directory.is_dir():
            raise UsageError(f"--cache {directory}: found a file, expected a directory")
        os.environ[_CACHE] = str(directory.absolute())


def take_cache(words: list[str]) -> list[str]:
    """Returns the words behind a command without `--cache DIR`, which it obeys. Raises UsageError without a DIR."""
    for i, word in enumerate(words[: words.index("--")] if "--" in words else words):
        name, equals, directory = word.partition("=")
        if name == "--cache":
            behind = [directory] if equals else words[i + 1 : i + 2]
            if not behind or not behind[0]:
                raise UsageError("--cache: found nothing, expected a directory for compiled code")
            choose_cache(Path(behind[0]))
            return take_cache(words[:i] + words[i + (1 if equals else 2) :])
    return words


@dataclass
class DeviceOptions:
    """The device of a scene: at a port, or the mock."""

    scene: SceneFile
    port: Port = None
    mock: MockFlag = False
    transport: str | None = option(
        "KIND",
        "Mock transport: loopback (in memory, virtual time), paced (in memory, real time) or terminal "
        "[default: loopback if clock: lockstep, else terminal; served: paced]",
    )

    def load(self) -> Any:
        """Returns the scene, with the port that the options name; warns of ports that the mock replaces. Raises
        SceneError."""
        scene = load(self.scene, self.port)
        devices = scene.devices.values() if scene.ports else (scene.device,)
        ports = [one.port for one in devices if one.port is not None]
        if self.transport is not None and self.port is None and ports:
            warn(f"--transport {self.transport} is of the mock, which runs in place of {listed(ports)}.", "transport")
        return scene

    def kind(self) -> Any:
        """Returns the TransportKind. Raises UsageError where the options contradict each other."""
        return transport_kind(self.mock, self.transport, self.port)

    def words(self) -> list[str]:
        """Returns the options as another command takes them."""
        given = {"--port": self.port, "--transport": self.transport}
        return ["--mock"] * self.mock + [word for name, value in given.items() if value for word in (name, value)]

    def print_next_run(self, scene: Any, unstable: bool) -> None:
        """Prints the command that runs the scene: with its page, or for 10 s of virtual time. Nothing where the command
        may run an unstable scene."""
        shown = ("--duration", "10") if scene.device.clock == "lockstep" else ("--serve",)
        if not unstable:
            print_next("run", self.scene, *self.words(), *shown)


@dataclass
class RecordOptions:
    """The file that a trace is written to."""

    record: Path | None = option("FILE", "Write the trace to this file: .trace, .npz or .csv.")
    overwrite: bool = flag("--overwrite", "Replace existing files.")

    def require_writable(self) -> None:
        """Raises UsageError if the file cannot be written, or exists without --overwrite."""
        if self.record is None:
            return
        from hapsim.recording.trace import require_writable_as_trace

        require_writable_as_trace(self.record)
        self.require_free(self.record)

    def require_free(self, *files: Path) -> None:
        """Raises UsageError if one of the files exists without --overwrite."""
        for path in files:
            if path.is_file() and not self.overwrite:
                raise UsageError(f"{path}: the file exists; --overwrite replaces it")

    def files_of(self, channels: Sequence[int]) -> list[Path]:
        """Returns the files of the traces of these channels: that one, or of several one each, with the channel's
        number in its name; none if no file is named."""
        if (path := self.record) is None or len(channels) == 1:
            return [] if path is None else [path]
        return [path.with_name(f"{path.stem}.{channel}{path.suffix}") for channel in channels]

    def save(self, channels: Sequence[int], *traces: Any) -> None:
        """Writes the traces of these channels, or of the first of them."""
        for path, trace in zip(self.files_of(channels), traces, strict=False):
            trace.save(path)


@dataclass
class PictureOptions:
    """Files for a picture and its numbers."""

    picture: Path | None = option("FILE", "Draw the result to this file: .svg, .png or .pdf.")
    data: Path | None = option("FILE.csv", "Write the numbers of the picture to this file.")

    @property
    def wanted(self) -> bool:
        """True if a file is named."""
        return self.picture is not None or self.data is not None

    def require_writable(self) -> None:
        """Raises UsageError where one of the files cannot be written: before a run, not after it."""
        from hapsim.recording.background_file import require_writable

        if self.picture is not None:
            require_writable(self.picture, ".svg", ".png", ".pdf")
        if self.data is not None:
            require_writable(self.data, ".csv")

    def write(self, columns: Callable[[], Mapping[str, Iterable[Any]]], draw: Callable[[Path], object]) -> None:
        """Writes the named files: the numbers, `columns` by their headings, and the picture that `draw` writes."""
        if self.data is not None:
            from hapsim.chart.figure import save_rows

            save_rows(columns(), self.data)
        if self.picture is not None:
            from hapsim.chart.figure import labelled_in

            with labelled_in(output_units()):
                draw(self.picture)

    def print_written(self) -> None:
        """Prints the names of the written files."""
        print_written("Picture", self.picture)
        print_written("Its numbers", self.data)


def print_written(what: str, path: Path | None) -> None:
    """Prints the name of a written file, if there is one."""
    if path is not None:
        print_line(f"{what}: {path}")


def print_next(command: str, scene: str, *words: str) -> None:
    """Prints the command to try next with the scene of this path; nothing for a scene on standard input."""
    if scene != _STANDARD_INPUT:
        device = ("--device", _chosen[0]) if _chosen else ()
        # On one line: it is to be copied.
        print("Next: hapsim", command, command_line(as_argument(scene), *words, *device))


def load(path: str, port: str | None = None) -> Any:
    """Returns the Scene of a file, or with "-" of standard input, on `port` if one is given. Raises SceneError."""
    from hapsim.scene import load_scene
    from hapsim.scene.load import read_scene

    scene = read_scene(sys.stdin.buffer, scene_name(path)) if path == _STANDARD_INPUT else load_scene(path)
    if _chosen:
        scene = scene.with_others_held(_chosen[0])
    set_output_units(scene.units, *(() if scene.ports else map(scene.units_of, range(scene.channels))))
    return scene if port is None else on_port(scene, port)


_chosen: list[str] = []  # the device that --device names


def choose_device(name: str | None) -> None:
    """Sets the device of several whose scene `load` returns, with points of the others held still; None: all."""
    _chosen[:] = [] if name is None else [name]


def scene_name(path: str) -> str:
    """Returns the name of the scene in sentences."""
    return "standard input" if path == _STANDARD_INPUT else path


def require_file(path: str, option: str) -> None:
    """Raises UsageError where the scene is on standard input and `option` needs its file."""
    if path == _STANDARD_INPUT:
        raise UsageError(f"{option}: found a scene on standard input (-), expected the scene's file")


def require_watchable(scene: Any, watch: bool) -> None:
    """Raises UsageError if --watch is given for one of several devices."""
    if watch and scene.device_name is not None:
        device = f"--device {scene.device_name}"
        raise UsageError(f"--watch: found {device} too, expected one of them: the file has all devices")


def on_port(scene: Any, port: str | None) -> Any:
    """Returns the scene with its device at another port; None: the mock. `port`: of several devices such as
    left=/dev/ttyACM0,right=/dev/ttyACM1."""
    if scene.ports and port is not None:
        return _on_ports(scene, port)
    return scene.model_copy(update={"device": scene.device.model_copy(update={"port": port})})


def _on_ports(scene: Any, text: str) -> Any:
    ports = dict[str, str]()
    for word in text.split(","):
        name, _, port = word.partition("=")
        if name not in scene.ports or not port:
            such = ",".join(f"{one}=/dev/ttyACM{i}" for i, one in enumerate(scene.ports))
            raise UsageError(f"--port: found '{word}', expected the port of a device, such as {such}")
        ports[f"devices.{name}.port"] = port
    return scene.changed(ports).read_from(scene.path)


def transport_kind(mock: bool, transport: str | None, port: str | None) -> Any:
    """Returns the TransportKind that three options name. Raises UsageError where they contradict each other."""
    if port is not None and (mock or transport is not None):
        raise UsageError("--port names a device, --mock and --transport the mock: found both, expected one of them")
    if transport is not None and transport not in ("loopback", "paced", "terminal"):
        raise UsageError(f"--transport: found '{transport}', expected loopback, paced or terminal")
    return transport or ("mock" if mock else "auto")


def names(words: list[str] | None) -> list[str]:
    """Returns the words of an option that may be repeated, and may hold several words with commas between them."""
    return ",".join(words).split(",") if words else []


def numbers(option: str, words: list[str] | None, unit: str = "") -> list[float]:
    """Returns the numbers of such an option, sorted, each once; with `unit` as `Quantity`. Raises UsageError."""
    found = set()
    for word in names(words):
        try:
            found.add(quantity(option, word, unit) if unit else float(word))
        except ValueError:
            raise UsageError(
                f"{option}: found '{word}', expected a number, or several with commas between them"
            ) from None
    return sorted(found)


def places(option: str, text: str | None, count: int) -> tuple[tuple[float, float], ...] | None:
    """Returns the places X,Y of an option, with colons between them, in m; None where it is not given. Raises
    UsageError."""
    if text is None:
        return None
    try:
        found = [tuple(quantity(option, word, "m") for word in place.split(",")) for place in text.split(":")]
    except ValueError:
        found = []
    such = "0.01,0 or 10mm,0" if count == 1 else "0,0:0.01,0 or 0,0:10mm,0"
    if len(found) != count or any(len(place) != 2 or not all(map(math.isfinite, place)) for place in found):
        raise UsageError(f"{option}: found '{text}', expected {':'.join(['X,Y'] * count)}, such as {such}")
    for place in found:
        require_units(Units.parse("linear"), *place)
    return tuple((float(x), float(y)) for x, y in found)


def hand_channel(scene: Any, channel: int | None) -> int:
    """Returns the channel of `--channel`, or of the first hand. Later output has its units. Raises UsageError if no
    hand is there."""
    channels = [point.channel for point in scene.device_points.values()]
    chosen: int = channels[0] if channel is None else channel
    if chosen not in channels:
        known = ", ".join(map(str, channels))
        raise UsageError(f"--channel {chosen}: the scene has nothing there; its device points are on: {known}")
    use_channel_units(chosen)
    return chosen


def place_at(scene: Any, text: str | None, units: Units | None = None) -> float | tuple[float, float] | None:
    """Returns the position that `--at` names, m or rad: in the plane x and y; None where it is not given. `units`: of
    the hand [default: the scene's]. Raises UsageError where it does not fit the scene."""
    if text is None:
        return None
    if scene.space == 1:
        if "," in text:
            raise UsageError(f"{_AT}: found {text}, expected a position in a scene with one coordinate")
        value = _number_parser(partial(quantity, _AT, unit="m"), _AT, None, None)(text)
        require_units(scene.units if units is None else units, value)
        return value
    if "," not in text:
        raise UsageError(f"{_AT}: found {text}, expected X,Y in a scene with space: 2")
    ((x, y),) = places(_AT, text, 1) or ()
    return x, y


def on_command_line(command: Callable[..., None]) -> Callable[..., None]:
    """Returns `command` as typer takes it: arguments that are dataclasses are spread into options, and the docstring
    has one line for each paragraph, which typer then breaks where the terminal ends."""
    groups: dict[str, type] = {}
    declared = []
    for name, parameter in inspect.signature(command, eval_str=True).parameters.items():
        if is_dataclass(parameter.annotation):
            group = groups[name] = cast(type, parameter.annotation)
            annotations = get_type_hints(group, include_extras=True)
            declared += [_as_typer_takes(one.name, annotations[one.name], one) for one in fields(group)]
        else:
            declared.append(_as_typer_takes(name, parameter.annotation, parameter.default))
    takes_device = has_device_option(declared)
    if takes_device:
        declared.append(_as_typer_takes(_OF_DEVICE, Device, None))

    def call(**given: Any) -> None:
        choose_device(given.pop(_OF_DEVICE) if takes_device else None)
        for name, group in groups.items():
            given[name] = group(**{field.name: given.pop(field.name) for field in fields(group)})
        try:
            command(**given)
        except KeyboardInterrupt:
            note_interrupt()
            raise

    paragraphs = inspect.cleandoc(command.__doc__ or "").split("\n\n")
    call.__doc__ = "\n\n".join(" ".join(paragraph.splitlines()) for paragraph in paragraphs)
    call.__signature__ = inspect.Signature(declared)  # type: ignore[attr-defined]
    call.__annotations__ = {parameter.name: parameter.annotation for parameter in declared}
    return call


def has_device_option(declared: Iterable[inspect.Parameter]) -> bool:
    """Returns whether a command of these parameters takes --device: it takes a scene, and has no such option itself."""
    names = {one.name for one in declared}
    return "scene" in names and "device" not in names


def _number_parser(kind: Callable[[Any], Any], option: str, least: Any, most: Any) -> Callable[[Any], float]:
    """Returns a function that reads the number of an option. `least`, `most`: its range, or None."""
    expected = "a whole number" if kind is int else "a position" if option == _AT else "a number"
    if least is not None:
        expected += f" >= {least}" if most is None else f" from {least} to {most}"

    def parse(text: Any) -> float:
        """Returns the number. Raises UsageError beyond the range."""
        with contextlib.suppress(ValueError):
            value = kind(text)
            if (least is None or value >= least) and (most is None or value <= most):
                return value
        raise UsageError(f"{option}: found '{text}', expected {expected}")

    return parse


def _as_typer_takes(name: str, annotation: Any, default: Any) -> inspect.Parameter:
    """Returns a parameter with what `option` declared in its annotation, and its default. `default`: that, or the
    declaration."""
    if isinstance(default, Field):
        if default.metadata:
            annotation = Annotated[annotation, default]
        default = default.default
    if get_origin(annotation) is Annotated:
        kind, declaration = get_args(annotation)
        if isinstance(declaration, Field):
            unit, declaration = declaration.metadata.get(_UNIT), copy(declaration.metadata[_TYPER])
            named = declaration.default  # typer's first argument: the name, if there is one
            option = named if isinstance(named, str) else "--" + name.replace("_", "-")
            number: Any = next((one for one in (int, float) if one in (kind, *get_args(kind))), None)
            if unit:
                number = partial(quantity, option, unit=unit)
            if number is not None:
                declaration.parser = _number_parser(number, option, declaration.min, declaration.max)
        declaration.help = (declaration.help or "").replace(
            " [default:", r" \[default:"
        )  # or rich takes it for a style
        annotation = Annotated[kind, declaration]
    default = inspect.Parameter.empty if default in (..., MISSING) else default
    return inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, default=default, annotation=annotation)


def lines_of_mock(scene: Any) -> Any:
    """Returns how the mock of a scene follows lines; None if the scene has a port, or its host evaluates the law."""
    if scene.device.law != "board" or scene.device.port is not None:
        return None
    from hapsim.device.mock.assemble_mock import describe_mock

    return describe_mock(scene).lines
