"""Predictions before a device is armed: what is refused, and what is warned of."""

from __future__ import annotations

import contextlib
from collections.abc import Container

from hapsim.cli import output
from hapsim.cli.command_options import scene_name
from hapsim.cli.live import at_work
from hapsim.errors import UsageError
from hapsim.prediction import Prediction, predict, unlikely, warnings_about
from hapsim.prediction.force_bounds import slew_error
from hapsim.prediction.warnings import risks
from hapsim.running.requirements import refusal_to_arm
from hapsim.scene import Scene


def predict_before_arming(path: str, scene: Scene, unstable: bool) -> list[str]:
    """Predicts the scene of this file and prints its warnings; returns them. Raises UsageError if the scene is surely
    unstable and `unstable` is False, or if its slew limit is too slow for the mock."""
    if why := slew_error(scene):
        raise UsageError(why)
    prediction = predict(scene, with_margins=False)
    require_stable(path, scene, prediction, unstable)
    return print_warnings(scene, prediction)


def require_stable(path: str, scene: Scene, prediction: Prediction, unstable: bool) -> None:
    """Raises UsageError if the scene of this file is surely predicted unstable and `unstable` is False."""
    why = "" if unstable else refusal_to_arm(scene_name(path), scene, prediction)
    if why:
        raise UsageError(why)


def print_warnings(scene: Scene, prediction: Prediction, known: Container[str] = ()) -> list[str]:
    """Returns the warnings of a prediction, and prints those that are not `known`."""
    is_knocked = scene.device.law == "board"  # some seconds, where its links have pieces
    with at_work(output.stderr(), "knocking hands on the lines") if is_knocked else contextlib.nullcontext():
        warnings = warnings_about(scene, prediction)
    for warning in warnings:
        if warning not in known:
            output.warn(warning, "prediction")
    return warnings


def predict_devices(path: str, scene: Scene, unstable: bool) -> list[str]:
    """Predicts the scene of this file: all devices together, and each while the others are held still. Prints the
    warnings; returns them. Raises UsageError if a part is surely unstable and `unstable` is False, or if a slew limit
    is too slow."""
    together, mistakes = predict(scene, with_margins=False), unlikely(scene)
    found, of_each = [*mistakes], {*mistakes}
    for part in together.every:
        require_stable(path, part.scene, part, unstable)
    for name in scene.ports:
        alone = scene.with_others_held(name)
        if why := slew_error(alone):
            raise UsageError(f"{name}: {why}")
        warnings = risks(alone, predict(alone, with_margins=False), mistakes)
        found, of_each = [*found, *(f"{name}: {one}" for one in warnings)], of_each.union(warnings)
    found += [one for one in warnings_about(scene, together) if one not in of_each]
    for warning in found:
        output.warn(warning, "prediction")
    return found
