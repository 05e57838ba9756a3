"""A scene from a configuration of SmartKnob (github.com/scottbez1/smartknob): its message PB.SmartKnobConfig as JSON.

The firmware (motor_task.cpp) gives 4 V/rad times a strength, without force near a detent's centre, and the next
position takes over at the snap point. In its terms a position is a place of a `detent`, and counts along the angle.
"""

from __future__ import annotations

import json
import math
import re
from pathlib import Path
from typing import Any, NamedTuple

from hapsim.errors import UsageError
from hapsim.number_format import rounded_up

from .issue import did_you_mean
from .shipped import shipped_board

_P = 4.0  # V/rad, of a strength of 1
_DEAD = 0.2, math.radians(1.0)  # of a position's width, and at most
_D = (math.radians(3.0), 0.08), (math.radians(8.0), 0.02)  # width, V·s/rad for a strength of 1; level beyond
_TORQUE = 0.015 / 2.645  # N·m/V at standstill: guesses of configs/boards/smartknob.yaml
_MOST_V, _SLEW = 3.0, 70.0  # N·m/s: a slower force would come late
_DELAY_S = 2.75e-3  # delay and hold of that scene
_MOST_PLACES = 1000
_NUMBERS = {
    **dict.fromkeys(("position", "position_nonce", "min_position", "max_position", "led_hue"), int),
    **dict.fromkeys(("sub_position_unit", "position_width_radians", "detent_strength_unit"), float),
    **dict.fromkeys(("endstop_strength_unit", "snap_point", "snap_point_bias"), float),
}


class FromSmartKnob(NamedTuple):
    """Text of a scene, and sentences on what it does not say of the configuration."""

    text: str
    unsaid: list[str]


def scene_from_smartknob(path: Path) -> FromSmartKnob:
    """Returns the scene of a configuration in a JSON file, in snake_case or as protobuf writes it. UsageError."""
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise UsageError(f"{path}: cannot be read: {error.strerror}") from None
    except ValueError as error:
        raise UsageError(f"{path}: found no JSON: {error}; expected a SmartKnobConfig as JSON") from None
    if isinstance(found, dict) and isinstance(found.get("config"), dict):  # a SmartKnobState
        found = found["config"]
    if not isinstance(found, dict):
        raise UsageError(f'{path}: found {found!r:.60}, expected an object such as {{"position_width_radians": 0.17}}')
    config = _checked(path, {re.sub("[A-Z]", lambda one: f"_{one[0].lower()}", key): one for key, one in found.items()})
    return _written(path, config)


def _checked(path: Path, found: dict[str, Any]) -> dict[str, Any]:
    """Returns the values of all keys, 0 where they are missing, as in protobuf."""
    config: dict[str, Any] = {key: kind(0) for key, kind in _NUMBERS.items()} | {"text": "", "detent_positions": []}
    for key, value in found.items():
        if key not in config:
            raise UsageError(f"{path}: found '{key}', expected {', '.join(config)}{did_you_mean(key, config)}")
        kind = _NUMBERS.get(key)
        is_number = isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)
        fits = is_number and (kind is not int or value == int(value)) if kind else isinstance(value, type(config[key]))
        if key == "detent_positions":
            fits = fits and all(isinstance(one, int) for one in value)
        if not fits:
            words = {int: "a whole number", float: "a number"}.get(kind or str, "a text")
            words = "a list of whole numbers" if key == "detent_positions" else words
            raise UsageError(f"{path}: {key}: found {value!r}, expected {words}")
        config[key] = kind(value) if kind else value
    if not config["position_width_radians"] > 0.0:
        raise UsageError(f"{path}: position_width_radians: found none above 0, expected an angle in rad")
    for key in ("detent_strength_unit", "endstop_strength_unit", "snap_point_bias"):
        if config[key] < 0.0:
            raise UsageError(f"{path}: {key}: found {config[key]:g}, expected 0 or more, as the firmware does")
    if not 0.5 <= config["snap_point"] < 1.5:
        why = ": the firmware ignores it, as it would give energy" if config["snap_point"] < 0.5 else ""
        raise UsageError(f"{path}: snap_point: found {config['snap_point']:g}{why}; expected from 0.5 to below 1.5")
    return config


def _written(path: Path, config: dict[str, Any]) -> FromSmartKnob:
    width, hold = config["position_width_radians"], config["snap_point"]
    free, strength = min(_DEAD[0] * width, _DEAD[1]), config["detent_strength_unit"]
    stiffness, stop = (_P * _TORQUE * one for one in (strength, config["endstop_strength_unit"]))
    low, high, only = config["min_position"], config["max_position"], sorted({*config["detent_positions"]})
    is_bounded = low <= high
    if not is_bounded and only:  # what lies beyond has no force
        low, high, stop = min(only) - 1, max(only) + 1, 0.0
    fields = f"hold_until: {hold:g}, dead_zone: {math.degrees(free):.7g} deg"
    if is_bounded or only:
        if high - low >= _MOST_PLACES:
            raise UsageError(f"{path}: found {high - low + 1} positions, expected at most {_MOST_PLACES}")
        at = ", ".join(f"{math.degrees((n - config['position']) * width):.7g} deg" for n in range(low, high + 1))
        here = ", ".join(str(n - low) for n in only if low <= n <= high)
        fields += f", stop: {stop:.9g}{f', only: [{here}]' if only else ''},\n           places: [{at}]"
    else:
        fields += f", pitch: {math.degrees(width):.7g} deg"
    depth = stiffness * (hold * width - free)
    own = 0.0 if only else strength * _TORQUE * _damping(width)
    damping = max(own, float(rounded_up(max(stiffness, stop) * _DELAY_S, 2)))
    unsaid = _unsaid(config, only, is_bounded, own, damping)
    _, _, body = shipped_board("smartknob").partition("version: 1\n")
    limit = f"force_limit: {_MOST_V * _TORQUE:.4g}         # N·m: {_MOST_V:g} V at {_TORQUE:.4g} N·m/V"
    device = re.sub("force_limit: .*", limit, body.partition("modules:\n")[0])
    device = re.sub("slew_limit: 40 ", f"slew_limit: {_SLEW:g} ", device)
    title = " ".join(config["text"].split()) or "A knob"
    place = f"place 0 is position {low}" if is_bounded or only else f"place 0 is position {config['position']}"
    notes = "".join(f"#   {one}\n" for one in unsaid)
    frame = 0.0 - config["sub_position_unit"] * width
    return FromSmartKnob(
        f"# {title}: from SmartKnob's {path.name}; {place}.\n#\n# What the scene does not say of it:\n{notes}"
        f"# Guesses of the device as in `hapsim new --board smartknob`.\nversion: 1\n{device}modules:\n"
        f"  knob:   {{type: device, channel: 0}}\n  frame:  {{type: ground, position: {frame:.9g}}}\n"
        f"  detent: {{type: detent, between: [knob, frame], depth: {depth:.9g}, damping: {damping:.6g}, {fields}}}\n",
        unsaid,
    )


def _damping(width: float) -> float:
    """Returns D of the firmware for a strength of 1, V·s/rad."""
    (narrow, strong), (wide, weak) = _D
    return strong + (weak - strong) * min(max((width - narrow) / (wide - narrow), 0.0), 1.0)


def _unsaid(config: dict[str, Any], only: list[int], is_bounded: bool, own: float, damping: float) -> list[str]:
    """Returns what the scene does not say of a configuration, in sentences without a full stop."""
    found = []
    if bias := config["snap_point_bias"]:
        found.append(f"snap_point_bias {bias:g}: a place holds alike on both sides of it")
    if config["led_hue"]:
        found.append(f"led_hue {config['led_hue']}: a scene has no light")
    if only and not is_bounded:
        found.append("positions far from the detents have no number")
    if damping > own:
        needed = f"damping {damping:g} N·m·s/rad covers hapsim's delay"
        found.append(f"{needed}; the firmware's own D is {own:.3g}")
    elif own:
        found.append("the kick of the firmware's D at each new position, and its damping's end in the dead zone")
    found.append("a centre that follows a hand at rest, and no torque above 60 rad/s")
    return found
