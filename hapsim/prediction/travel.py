"""The band outside a device's travel in which the force fades, as a stiffness that the loop has to render.

A force F that pushes outward and fades over the margin is a spring of F / margin that pulls inward, sampled, held and
late as any other. It has no damper: the scene's own fades with it, and a force at its limit has none. So the loop of
the device alone judges it. A device that nothing holds does not stay there, the force drives it through the band; so a
hand is part of the loop, and one that grips a handle damps it by HAND_DAMPING at least. Without that no band would do
for a device without friction. Where the force pushes inward the fade is a negative stiffness of the same size: there
the hand meets less and less, which no sampling makes worse.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

from hapsim.number_format import rounded_up
from hapsim.prediction.hands import configuration_of
from hapsim.scene import Scene

HAND_DAMPING = 5.0
"""N·s/m, of a light grip (0.5 kg and 300 N/m beside it; a firm one has 20)."""


def refused_travel(scene: Scene) -> str:
    """Where the force fades over too short a way for the loop: a sentence without a full stop; "" where not."""
    device = scene.device
    if device.travel is None:
        return ""
    for channel, margin in enumerate(device.travel_margins(scene.channels)):
        stable = fade_stiffness(scene, channel)
        if not device.force_limit <= stable * margin:
            where = f" on channel {channel}" if scene.channels > 1 else ""
            return (
                f"device.travel_margin: the force of up to {device.force_limit:g} N fades over {margin:g} m{where}, "
                f"which is a stiffness of {device.force_limit / margin:.4g} N/m and shakes the hand: with no damper "
                f"but the hand's {HAND_DAMPING:g} N·s/m and the device's friction this loop renders up to "
                f"{stable:.4g} N/m; expected at least {rounded_up(device.force_limit / stable)} m, or a lower "
                "device.force_limit"
            )
    return ""


def fade_stiffness(scene: Scene, channel: int) -> float:
    """N/m: up to which stiffness the loop of a channel is stable, held by a hand and without a simulated damper, for
    the least mass that the scene declares."""
    loop = configuration_of(scene, channel)
    least, _ = scene.device.mass_spans(scene.channels)[channel]
    _, most = replace(loop, mass=least, friction=loop.friction + HAND_DAMPING).stable_stiffness(0.0)
    return float(most) if math.isfinite(most) else 0.0


def travel_document(scene: Scene) -> dict[str, Any]:
    """Limits, margin and origin of every channel, in m: None where there is none, "here" for the position at arming."""
    device, channels = scene.device, scene.channels
    return {
        "limits_m": None if device.travel is None else device.travels(channels),
        "margin_m": None if device.travel is None else device.travel_margins(channels),
        "origin_m": ["here" if origin is None else origin for origin in device.origins(channels)],
    }
