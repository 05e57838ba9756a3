"""The motors behind a port: which are known to push the right way, and how hard an unknown one may push.

A motor that pushes the wrong way turns a wall into a trap. The sign guard finds most of them, but not where it cannot
judge them. There a run has only SHARE of the force limit, until a test has shown the motor right or the scene limits
the way by device.travel. The share goes into the device's description, so that the loop, its guards and a record have
it like any limit of a device.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple

from firmware_protocol.description import Description
from hapsim.device.connection import Connection, describe
from hapsim.device.known_motors import known_motors, note_motors, serial_number
from hapsim.device.open_connection import open_connection
from hapsim.errors import UsageError
from hapsim.loop.guards import guard_that_ended
from hapsim.prediction.force_bounds import unjudged_motors
from hapsim.prediction.linear import with_device
from hapsim.recording.trace import Trace
from hapsim.running.requirements import require_compatible
from hapsim.scene import Scene

SHARE = 0.1
"""Share of the force limit for motors that nothing has shown to be right and that the sign guard cannot judge."""


class Motors(NamedTuple):
    """The motors of a run."""

    known: tuple[int, ...]
    """Channels whose motors are known to push the right way."""
    description: Description
    """Description of the device, with the force limits of this run."""
    advice: str = ""
    """Sentence about motors that are not known, with what shows that they are right; "" if there are none."""
    lowered: tuple[int, ...] = ()
    """Channels whose force limit is lowered."""

    @property
    def warning(self) -> str:
        """The advice, if a force limit is lowered; else ""."""
        return self.advice if self.lowered else ""


def _may_be_lowered(scene: Scene) -> bool:
    """Returns whether a run of this scene at its port may have a lower force limit: no travel, and unknown motors."""
    used = range(scene.channels)
    in_hand = scene.device.port is not None and scene.device.clock != "lockstep" and not scene.device.is_admittance
    return in_hand and scene.device.travel is None and not known_motors(scene.device.port or "", used).issuperset(used)


def motors_of(scene: Scene, connection: Connection, description: Description) -> Motors:
    """Returns the motors of a scene and this device. Those of the mock, in virtual time, and of a servo (following.py)
    need no test."""
    if not connection.behind_port or scene.device.clock == "lockstep" or scene.device.is_admittance:
        return Motors((), description)
    known = known_motors(connection.name, range(scene.channels))
    unknown = [hand for hand in scene.channel_groups if not known.issuperset(hand)]
    if not unknown:
        return Motors(tuple(sorted(known)), description)
    reasons = unjudged_motors(scene, description)
    unjudged = [hand for hand in unknown if any(reasons[c] for c in hand)] if scene.device.travel is None else []
    lowered = tuple(c for hand in unjudged for c in hand)
    tenths = [SHARE * min(limit, scene.device.force_limit) for limit in description.force_limit]
    limits = tuple(tenths[c] if c in lowered else limit for c, limit in enumerate(description.force_limit))
    hand = (unjudged or unknown)[0]
    reason = next((reasons[c] for c in hand if reasons[c]), "") if lowered else ""
    advice = _advice(scene, connection.name, hand, tenths[hand[0]], reason)
    return Motors(tuple(sorted(known)), replace(description, force_limit=limits), advice, lowered)


def _advice(scene: Scene, port: str, hand: tuple[int, ...], tenth: float, reason: str) -> str:
    """Returns a sentence, without a full stop, about the unknown motors of a hand. `tenth`: of the force limit, N.
    `reason`: why the guard cannot judge them, if that lowers the limit."""
    of = f" of {scene.device_name}" if scene.device_name else ""
    motors, them = f"motor of channel {hand[0]}{of} pushes", "it"
    options = f" --channel {hand[0]}" if hand[0] else ""
    if hand[1:]:
        motors, them = f"motors of channels {hand[0]} and {hand[1]}{of} push", "them"
        options = f" --pair {hand[0]},{hand[1]}"
    found = f"{port}: no test has shown that the {motors} the right way"
    test = f"`hapsim probe {port} --push {tenth:.3g}{options}` or `hapsim identify`"
    is_kept, nameless = bool(serial_number(port)), "the port has no serial number, by which hapsim could keep a result"
    if not reason:
        until = "Hold it loosely until then" if is_kept else f"Hold it loosely in every run: {nameless}"
        return f"{found}: {test} tests {them}. {until}"
    lifts = f"{test} lifts that, a device.travel in the scene, or a run in which the guard finds the motor right"
    return (
        f"{found}, and the sign guard cannot judge {them}: {reason}. So the force limit is a tenth, "
        f"{scene.units_of(hand[0])(tenth, 'N', '.3g')}. "
        + (lifts if is_kept else f"Only a device.travel in the scene lifts that: {nameless}")
    )


def as_limited(
    scene: Scene, channels: Sequence[int], push: float | None, run: Callable[..., Trace], options: Any
) -> tuple[Scene, Callable[..., Trace]]:
    """Returns, for a measurement, the scene with the force limit of its runs on these channels, so that pushes are made
    for it, and `run` with these options. At a port whose motors are not known to be right that may be a tenth of the
    scene's: `on_warning` says so. Raises UsageError if that is less than `push` (N)."""
    warn, own = options.pop("on_warning", None), scene.device.force_limit
    with_options = partial(run, **options)
    kind = options.get("transport", "auto")
    if kind != "auto" or not _may_be_lowered(scene):
        return scene, with_options
    with open_connection(scene, kind) as connection:
        description = describe(connection)
        require_compatible(scene, connection.name, description)
        motors = motors_of(scene, connection, description)
    if not set(channels) & set(motors.lowered):
        return scene, with_options
    limit = min(motors.description.force_limit[c] for c in channels)
    if push is not None and push > limit:
        units = scene.units_of(channels[0])
        found, most = units(push, "N", "g"), units(limit, "N", ".3g")
        raise UsageError(f"push: found {found}, expected at most {most}. {motors.warning}")
    if warn is not None:
        warn(motors.warning)

    def run_with_own_limit(scene: Scene, **more: Any) -> Trace:
        return with_options(with_device(scene, force_limit=own), **more)

    return with_device(scene, force_limit=limit), run_with_own_limit


def note_end(loop: Any, scene: Scene, port: str, ending: int) -> None:
    """Keeps which motors the sign guard of a run at this port found right; forgets those of a hand that a guard stopped
    because its motor may push the wrong way. `loop`: LOOP."""
    note_motors(port, [c for c in range(scene.channels) if loop.sign.is_right[c]], are_right=True)
    guard = guard_that_ended(ending)
    if guard is not None and (channel := guard.stopped_motor(loop)) >= 0:
        note_motors(port, scene.hand_of(channel), are_right=False)
