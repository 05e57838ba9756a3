"""What a record says of the run beside its rows, so that the run can be replayed."""

from __future__ import annotations

from dataclasses import asdict
from importlib.metadata import version
from typing import Any, cast

from firmware_protocol.description import Description
from hapsim.number_format import plain
from hapsim.prediction import predict
from hapsim.prediction.felt import felt_document
from hapsim.running.assemble import LoopMemory
from hapsim.running.changes import document_of
from hapsim.running.options import Excitation, Guide, PeriodicExcitation, RunOptions
from hapsim.scene import Scene

_OPTIONS = ("unstable", "judges_energy", "judges_sign")


def run_of(
    scene: Scene, loop: LoopMemory, description: Description, behind_port: bool, in_python: bool, options: RunOptions
) -> dict[str, Any]:
    """Returns the document of a run. `behind_port`: as of a Connection; `in_python`: whether the loop is not compiled.
    `options_of`, `description_of` and `hapsim.scene.parse_scene` read it."""
    return {
        "scene": document_of(scene),
        "first_tick": int(loop.state.ticks),
        "description": asdict(description),
        "behind_port": behind_port,
        "in_python": in_python,
        "options": {name: getattr(options, name) for name in _OPTIONS},
        "excitation": _document_of_pushes(options.excitation),
        "versions": versions_of_now(),
    }


def prediction_of(scene: Scene) -> dict[str, Any]:
    """Returns what is predicted of a scene, for a record: `stable`, `spectral_radius`, `poles` and `device_points` as
    `hapsim check --json` prints them; `error` where it cannot be predicted."""
    try:
        found = predict(scene, with_margins=False)
    except Exception as error:  # a record does not depend on it
        return {"error": str(error) or type(error).__name__}
    hands = {felt.name: felt_document(felt) for felt in found.felt}
    whole = {"stable": found.stable, "spectral_radius": found.spectral_radius, "poles": found.poles}
    document: dict[str, Any] = plain(whole | {"device_points": hands})
    return document


def versions_of_now() -> dict[str, str]:
    """Returns what the last bit of a force depends on, beside the scene: versions, and the kind of processor."""
    from llvmlite.binding import get_host_cpu_name  # type: ignore[import-untyped]

    packages = ("hapsim", "numba", "llvmlite", "numpy")
    return {"processor": get_host_cpu_name()} | {name: version(name) for name in packages}


def options_of(run: dict[str, Any]) -> RunOptions:
    """Returns the options of a recorded run that its forces depend on. KeyError or TypeError where it is damaged."""
    pushes = run["excitation"]
    excitation: Excitation | PeriodicExcitation | None = None
    if pushes is not None and "forces" in pushes:
        excitation = PeriodicExcitation(**pushes)
    elif pushes is not None:
        guide = pushes["guide"]
        found = None if guide is None else Guide(**{**guide, "seconds": tuple(guide["seconds"])})
        excitation = Excitation(**{**pushes, "guide": found})
    return RunOptions(**run["options"], excitation=excitation)


def description_of(run: dict[str, Any]) -> Description:
    """Returns how the device of a recorded run described itself. KeyError or TypeError where it is damaged."""
    fields = {name: tuple(value) if isinstance(value, list) else value for name, value in run["description"].items()}
    return Description(**cast(dict[str, Any], fields))


def _document_of_pushes(excitation: Excitation | PeriodicExcitation | None) -> dict[str, Any] | None:
    if isinstance(excitation, PeriodicExcitation):
        return {"channel": excitation.channel, "forces": excitation.forces.tolist()}
    return None if excitation is None else asdict(excitation)
