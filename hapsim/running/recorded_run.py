"""The document of a run in its record, beside the rows, so that the run can be replayed."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from importlib.metadata import version
from typing import Any, Literal

from firmware_protocol.description import Description
from hapsim.documents import pick, plain
from hapsim.loop.exchange import MEMORY_CLOCK
from hapsim.loop.ring import SENSED
from hapsim.prediction import predict
from hapsim.prediction.board_words import carried
from hapsim.recording.report import validated
from hapsim.running.assemble_loop import LoopMemory
from hapsim.running.session_options import Excitation, PeriodicExcitation, RunOptions
from hapsim.running.snapshot import LoopState
from hapsim.scene import Scene

_OPTIONS = ("unstable", "judges_energy", "judges_sign")


@dataclass(frozen=True)
class RecordedRun:
    """A document of `run_of`, parsed."""

    scene: dict[str, Any]
    first_tick: int
    description: Description
    behind_port: bool
    in_python: bool
    options: dict[Literal["unstable", "judges_energy", "judges_sign"], bool | None]
    excitation: Excitation | dict[str, Any] | None
    versions: dict[str, str]
    known_motors: tuple[int, ...] = ()
    paced: bool = False
    """True if the mock in memory ran in real time: leases then counted nanoseconds, though the scene is in lockstep."""
    text: str | None = None
    """The text of the scene's file."""
    state: LoopState | None = None
    """State in the first tick of a record that begins during a run."""


def read_run(run: dict[str, Any], channels: int) -> RecordedRun:
    """Returns the run of a record with this number of channels. Raises ValueError if it is damaged."""
    found: RecordedRun = validated(RecordedRun, run)
    of = found.description
    if {channels} != {len(of.position_scale), len(of.force_scale), len(of.force_limit)}:
        raise ValueError(f"found a device of {of.channels} channels, expected {channels}")
    for name in SENSED:
        if (scale := of.scale(name)) and len(scale) != channels:
            raise ValueError(f"found {len(scale)} {name} scales, expected {channels}")
    return found


def run_of(
    scene: Scene, loop: LoopMemory, in_python: bool, options: RunOptions, state: LoopState | None = None
) -> dict[str, Any]:
    """Returns the document of a run. `scene`: with which the record begins. `in_python`: the loop is not compiled.
    `state`: where its record begins [default: with the run]. Readers: `read_run`, `options_of` and
    `hapsim.scene.load.recorded_scene`."""
    excitation, pushes, setting = options.excitation, None, loop.setting
    if isinstance(excitation, PeriodicExcitation):
        pushes = {"channel": excitation.channel, "forces": excitation.forces.tolist()}
    elif excitation is not None:
        pushes = asdict(excitation)
    return {
        "text": scene.origin and scene.origin.text,
        "scene": state.scenes[-1] if state else scene.ranged_document,
        "first_tick": state.tick if state else 0,
        "state": asdict(state) if state else None,
        "description": asdict(setting.description),
        "behind_port": setting.behind_port,
        "known_motors": setting.known_motors,
        "in_python": in_python,
        "paced": bool(loop.control.clock == MEMORY_CLOCK),
        "options": {name: getattr(options, name) for name in _OPTIONS},
        "excitation": pushes,
        "versions": versions_of_now(),
    }


def prediction_of(scene: Scene, description: Description) -> dict[str, Any]:
    """Returns the prediction of a scene for the record of a run with this device: `stable`, `spectral_radius`, its
    `poles`, and by `device_points` the parts of one; `error` if there is no prediction."""
    try:
        found = carried(predict(scene, with_margins=False), description.lines)
        hands = {felt.name: felt for felt in found.felt}
        whole = pick(found, "stable spectral_radius poles") | {"device_points": hands}
    except Exception as error:  # the record is complete without it
        return {"error": str(error) or type(error).__name__}
    document: dict[str, Any] = plain(whole)
    return document


def versions_of_now() -> dict[str, str]:
    """Returns the versions and the type of processor, on which the last bit of a force depends beside the scene."""
    from llvmlite.binding import get_host_cpu_name  # type: ignore[import-untyped]

    packages = ("hapsim", "numba", "llvmlite", "numpy")
    return {"processor": get_host_cpu_name()} | {name: version(name) for name in packages}


def options_of(run: RecordedRun) -> RunOptions:
    """Returns the options of a recorded run that affect its forces. Raises TypeError or ValueError if it is damaged."""
    pushes = PeriodicExcitation(**run.excitation) if isinstance(run.excitation, dict) else run.excitation
    options: dict[str, Any] = {str(name): value for name, value in run.options.items()}
    return RunOptions(**options, excitation=pushes, transport="paced" if run.paced else "auto")
