"""What commands share: the arguments that several take, what becomes of them, and where people read."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple

import typer

from hapsim.cli.log import complain
from hapsim.cli.sentences import say
from hapsim.errors import UsageError

if TYPE_CHECKING:
    from hapsim.prediction import Prediction
    from hapsim.scene import Scene

SceneFile = Annotated[str, typer.Argument(metavar="SCENE", help="A scene in YAML, such as configs/first_touch.yaml.")]
Json = Annotated[bool, typer.Option("--json", help="Print one JSON document on standard output, nothing else there.")]
Port = Annotated[str | None, typer.Option(metavar="P", help="The device's serial port, in place of the scene's.")]
MockFlag = Annotated[bool, typer.Option("--mock", help="Use the embedded mock even where the scene names a port.")]
TransportOption = Annotated[
    str | None, typer.Option(metavar="KIND", help="Where the mock is: 'loopback' (in memory) or 'terminal'.")
]
Realtime = Annotated[
    bool,
    typer.Option("--realtime", help="Ask the system for what makes a loop steady; tell what it granted and what not."),
]
Unstable = Annotated[
    bool, typer.Option("--unstable", help="Run a scene that is predicted unstable, too: the hand is shaken.")
]
Data = Annotated[Path | None, typer.Option(metavar="FILE", help="Write the picture's numbers: .csv.")]
Record = Annotated[Path | None, typer.Option(metavar="FILE", help="Write the trace: .trace, .npz or .csv.")]
Reports = Annotated[
    Path | None,
    typer.Option(
        metavar="DIR",
        help="Where a run that a guard or a device ends leaves its report, the newest 20; left out: "
        "~/.local/state/hapsim/reports for a device on a port.",
    ),
]


class Files(NamedTuple):
    """Where a picture, its numbers and a trace go; None: nowhere."""

    picture: Path | None
    data: Path | None
    record: Path | None


def seconds_above_zero(value: float | None) -> float | None:
    if value is not None and not 0 < value < float("inf"):
        raise UsageError(f"--duration: found {value:g}, expected a finite number of seconds above 0")
    return value


def load(path: str, port: str | None = None) -> Scene:
    """The scene of a file, on `port` where one is given. SceneError where it is none."""
    from hapsim.scene import load_scene

    scene = load_scene(path)
    if port is None:
        return scene
    return scene.model_copy(update={"device": scene.device.model_copy(update={"port": port})})


def transport_kind(mock: bool, transport: str | None, port: str | None) -> Any:
    """Where the device is, a TransportKind, by three options. UsageError where they contradict each other."""
    if port is not None and (mock or transport is not None):
        raise UsageError("--port names a device, --mock and --transport the mock: found both, expected one of them")
    if transport is not None and transport not in ("loopback", "terminal"):
        raise UsageError(f"--transport: found '{transport}', expected loopback or terminal")
    return transport or ("mock" if mock else "auto")


def as_played(scene: Scene, kind: Any) -> Scene:
    """The scene for its prediction: without the port that it names where the mock stands in for it, which has no wire
    of a port. `kind`: as `transport_kind` gave it."""
    if kind == "auto":
        return scene
    return scene.model_copy(update={"device": scene.device.model_copy(update={"port": None})})


def require_files_writable(picture: Path | None = None, data: Path | None = None, record: Path | None = None) -> None:
    """UsageError where one of the files could not be written: better before the run than after it."""
    if picture is not None or data is not None:
        from hapsim.chart.figure import require_writable

        require_writable(picture)
        require_writable(data, (".csv",))
    if record is not None:
        from hapsim.recording.trace import require_writable_as_trace

        require_writable_as_trace(record)


def say_written(picture: Path | None = None, data: Path | None = None, record: Path | None = None) -> None:
    """Which files were written."""
    for what, path in (("Picture", picture), ("Its numbers", data), ("Trace", record)):
        if path is not None:
            say(f"{what}: {path}")


def predict_and_warn(scene: Scene) -> None:
    from hapsim.prediction import predict

    warn(scene, predict(scene, with_margins=False))


def predict_before_arming(path: str, scene: Scene, unstable: bool) -> list[str]:
    """Predicts the scene of this file, says what there is against running it, and returns that. UsageError where it is
    surely unstable, and that is not asked for, or its slew limit is too slow for the mock."""
    from hapsim.prediction import predict
    from hapsim.prediction.force_bounds import refused_slew

    if why := refused_slew(scene):
        raise UsageError(why)
    prediction = predict(scene, with_margins=False)
    require_stable(path, scene, prediction, unstable)
    return warn(scene, prediction)


def require_stable(path: str, scene: Scene, prediction: Prediction, unstable: bool) -> None:
    """UsageError where the scene of this file is surely predicted unstable, and that is not asked for."""
    from hapsim.running.stability import why_not_armed

    why = "" if unstable else why_not_armed(path, scene, prediction)
    if why:
        raise UsageError(why)


def warn(scene: Scene, prediction: Prediction) -> list[str]:
    """Says before a run what its prediction has against it, and returns it: the hand should know what is coming."""
    from hapsim.prediction import warnings_about

    warnings = warnings_about(scene, prediction)
    for warning in warnings:
        complain(warning, "prediction", "warning")
    return warnings


def stdout() -> Any:
    from rich.console import Console

    return Console(highlight=False)


def stderr() -> Any:
    from rich.console import Console

    return Console(stderr=True, highlight=False)
