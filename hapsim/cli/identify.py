"""`hapsim identify`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from hapsim.cli.arguments import (
    Data,
    Json,
    MockFlag,
    Port,
    SceneFile,
    TransportOption,
    complain,
    load,
    require_files_writable,
    say_written,
    seconds_above_zero,
    stderr,
    stdout,
    transport_kind,
)
from hapsim.cli.sentences import say
from hapsim.errors import UsageError

if TYPE_CHECKING:
    from collections.abc import Mapping

    from hapsim.measuring.identify_device import DeviceIdentification
    from hapsim.scene import Known, Scene


def identify(
    scene: SceneFile,
    port: Port = None,
    mock: MockFlag = False,
    transport: TransportOption = None,
    channel: Annotated[int | None, typer.Option(help="The channel that is pushed; left out: the first.")] = None,
    force: Annotated[
        float | None, typer.Option(metavar="N", help="Push with at most N newton; left out: a quarter of force_limit.")
    ] = None,
    travel: Annotated[
        float | None, typer.Option(metavar="M", help="End where the device moves farther, in m; left out: 0.005.")
    ] = None,
    duration: Annotated[
        float | None,
        typer.Option(metavar="S", callback=seconds_above_zero, help="Seconds recorded for the fit; left out: six."),
    ] = None,
    write: Annotated[
        bool, typer.Option("--write", help="Write what was found into the scene's `device`; left out: only tell it.")
    ] = False,
    picture: Annotated[Path | None, typer.Option(metavar="FILE", help="Draw what is left: .svg, .png, .pdf.")] = None,
    data: Data = None,
    json: Json = False,
) -> None:
    """Push the device, and identify its mass, friction, spring, delay and dry friction, each with its uncertainty.

    It pushes to either side, gently at first, at several simulated (K, B) of its own: of the scene only the device
    counts. The file stays as it is without --write.
    """
    from hapsim.cli.identify_table import before_pushing
    from hapsim.cli.live import live_line
    from hapsim.device.known_devices import is_new
    from hapsim.measuring.identify_device import SECONDS, bounds_of, identify_device

    loaded = load(scene, port)
    kind = transport_kind(mock, transport, port)
    require_files_writable(picture, data)
    _require_writable_scene(scene, write, bool(loaded.device.port) and kind != "auto")
    if channel is None:
        channel = next(iter(loaded.device_points.values())).channel
    loaded, travel = _within_travel(loaded, channel, travel)
    on_mock = kind != "auto" or loaded.device.port is None
    complain(
        before_pushing(
            bounds_of(loaded, force, travel), channel, None if on_mock else loaded.device.port, duration or SECONDS
        )
    )
    with live_line(stderr()) as tell:
        found = identify_device(
            loaded,
            channel=channel,
            force=force,
            travel=travel,
            duration=duration,
            transport=kind,
            on_progress=tell,
            stop_on_signals=True,
        )
    if not on_mock:
        is_new(loaded.device.port or "")  # from now on not
    _chart_residual(found, picture, data)
    _tell(scene, loaded, found, write, json)
    if not json:
        say_written(picture, data)


def _within_travel(scene: Scene, channel: int, travel: float | None) -> tuple[Scene, float | None]:
    """The scene, and how far the device may move from where it is found (m), so that it stays in the scene's travel.

    Each of the runs that push it would take another `origin: here`: these count from where they find it, and the
    limits are what is left to either side.
    """
    from hapsim.measuring.identify_device import TRAVEL_M

    device = scene.device
    if not 0 <= channel < scene.channels:
        return scene, travel
    least, most = device.travels(scene.channels)[channel]
    here = device.origins(scene.channels)[channel] is None
    room = min(most, -least) if here else 0.5 * (most - least)
    if here and room <= 0.0:
        raise UsageError(
            f"device.travel: found {least:g} to {most:g} m from where it is armed (origin: here), expected room "
            "to both sides to push it; put it in the middle of its travel, and leave out travel and origin for this"
        )
    if here:
        none = {"travel": None, "travel_margin": None, "origin": None}
        scene = scene.model_copy(update={"device": device.model_copy(update=none)})
    return scene, travel if room >= (TRAVEL_M if travel is None else travel) else room


def _tell(scene: str, loaded: Scene, found: DeviceIdentification, write: bool, json: bool) -> None:
    """Shows what was found, then writes it where that was asked for: if it cannot, it was shown at least."""
    from hapsim.cli.as_json import document
    from hapsim.cli.identify_table import (
        declared_of,
        has_span,
        identification_document,
        show_identification,
        values_to_write,
    )

    declared, span = declared_of(loaded, found.channel), has_span(loaded, found.channel)
    if not json:
        hand = next(name for name, point in loaded.device_points.items() if point.channel == found.channel)
        show_identification(stdout(), found, declared, hand)
    values = values_to_write(found, declared, span) if write and not found.stopped else None
    if values is not None:
        from hapsim.scene.rewrite import rewrite_device

        rewrite_device(scene, values, found.channel)
    if json:
        print(document({"scene": scene} | identification_document(found, declared, values)))
    else:
        _say_what_was_written(scene, values, write, span)


def _say_what_was_written(scene: str, values: Mapping[str, str | Known] | None, asked: bool, span: bool) -> None:
    if values is None:
        why = "it was stopped before all was recorded" if asked else "--write writes what was found into its `device`"
        say(f"The file was not changed; {why}.")
        return
    told = ", ".join(f"{name}: {value}" for name, value in values.items())
    stays = " The mass stays: the file gives a span for it, and this is one hand's." if span else ""
    say(f"Wrote into `device` of {scene}: {told}.{stays}")


def _require_writable_scene(scene: str, write: bool, of_mock: bool) -> None:
    if not write:
        return
    if of_mock:
        raise UsageError(
            "--write: found --mock or --transport beside a port: what is found of the mock is not its device's; leave "
            "out one of them"
        )
    from hapsim.scene.rewrite import require_rewritable

    require_rewritable(scene)


def _chart_residual(found: DeviceIdentification, picture: Path | None, data: Path | None) -> None:
    if picture is None and data is None:
        return
    from hapsim.chart.device_residual import draw_device_residual, residual_columns
    from hapsim.chart.figure import save_rows

    if data is not None:
        save_rows(residual_columns(found), data)
    if picture is not None:
        draw_device_residual(found, picture)
