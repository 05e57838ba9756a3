"""measure in `mode: admittance`: the mass and the damping that a hand of known stiffness feels.

The hand on the handle is the spring of the loop, so the motion gives the mass: with the poles s of its slowest pair,
m = k/|s|² and b = -2 m Re s - bh. k is the hand's stiffness and that of the scene's own links, bh its damping.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from functools import partial
from typing import NamedTuple, Unpack

import numpy as np

from hapsim.errors import DeviceError, RunError, UsageError
from hapsim.loop.ring import SLEWED
from hapsim.measuring.measure_trace import Measurement, measure_trace
from hapsim.measuring.measurement_options import Run, RunOptions, largest_push, require_pushable
from hapsim.measuring.pushes import duration_of, pushes, recorded
from hapsim.measuring.trace_quality import explained
from hapsim.number_format import plural
from hapsim.prediction.characteristic import characteristic_of
from hapsim.recording.trace import Trace
from hapsim.running import Excitation
from hapsim.scene import Scene
from hapsim.scene.values import per_channel

_SHARE_OF_ACCELERATION = 0.25  # of the limit: the hand that springs back adds to a push
_RETRIES, _LESS = 3, 0.25  # with this share of a push by which a contact changed


class KnownHand(NamedTuple):
    """The hand that holds the device while it is measured."""

    stiffness: float
    """N/m."""
    damping: float
    """N·s/m."""
    origin: str
    """The key that says it: mock.hand, or device.assumed_hand."""


@dataclass(frozen=True, repr=False)
class AdmittanceMeasurement:
    """The mass and the damping that the hand felt. Each value has its standard uncertainty."""

    DOCUMENT = (
        "m b frequency_hz=motion.frequency_hz damping_ratio=motion.damping_ratio m_uncertainty b_uncertainty "
        "hand_stiffness=hand.stiffness hand_damping=hand.damping hand_origin=hand.origin scene_stiffness push_n "
        "pole=motion.pole "
        "pole_uncertainty=motion.pole_uncertainty poles=motion.poles dominant reason order=motion.order "
        "samples=motion.samples residual_m=motion.residual_m"
    )

    m: float
    """Felt mass, kg."""
    b: float
    """Felt damping, N·s/m."""
    m_uncertainty: float
    b_uncertainty: float
    hand: KnownHand
    scene_stiffness: float
    """Stiffness of the scene's links where the hand was pushed, N/m; 0 where they end on masses."""
    motion: Measurement
    """The poles of the motion, and how they were found. Its k and b are those of a mass of 1 kg."""
    push_n: float
    """The largest push on the simulated mass, N."""
    failure: RunError | None = field(default=None, repr=False, compare=False)
    """The error that ended the run early; enough was recorded before it for the values above."""

    def __repr__(self) -> str:
        if not self.dominant:
            return f"<AdmittanceMeasurement of {self.motion.samples} samples: {self.reason}>"
        m, b = (
            f"{value:.6g} ± {off:.1g}" for value, off in ((self.m, self.m_uncertainty), (self.b, self.b_uncertainty))
        )
        return f"<AdmittanceMeasurement of {self.motion.samples} samples: m {m} kg, b {b} N·s/m>"

    @property
    def dominant(self) -> bool:
        """False if the slowest poles are not those of a mass and a damper; m and b are then NaN."""
        return self.motion.dominant

    @property
    def reason(self) -> str:
        """Reason why they are not; else ""."""
        return self.motion.reason

    @property
    def trace(self) -> Trace:
        """The record that was identified."""
        return self.motion.trace


def measure_admittance(
    scene: Scene, channel: int, duration: float | None, push: float | None, run: Run, **options: Unpack[RunOptions]
) -> AdmittanceMeasurement:
    """Pushes the simulated mass of `channel`, and identifies what the hand on the handle feels. Arguments as of
    `measure`, without a position. Without `push`, a run in which a contact changed is repeated with less. Raises
    UsageError without a hand of known stiffness, if too little moves, or if the motion passed a contact."""
    require_pushable(scene, [channel], duration, push)
    hand, duration = known_hand(scene, channel), duration_of(scene, duration)
    run = partial(run, **options)
    trace, failure, excitation = _pushed(run, scene, channel, duration, _gentle(scene, channel, push))
    changed, own = _links_at(scene, channel, trace)
    for _ in range(0 if push else _RETRIES):
        if not changed or failure or trace.report.ending != "done":
            break
        trace, failure, excitation = _pushed(run, scene, channel, duration, _LESS * excitation.force)
        changed, own = _links_at(scene, channel, trace)
    if changed:
        raise UsageError(
            f"{', '.join(changed)} changed while the hand was pushed, so that no single mass and damper describes its "
            "motion: push less (--push), or rest it elsewhere (mock.hand.position)"
        )
    if limited := int(np.count_nonzero(trace.flags & SLEWED)):
        raise UsageError(
            f"in {plural(limited, 'sample')} the motion was kept within device.speed_limit, acceleration_limit or "
            "slew_limit: push less (--push), begin at rest (mock.initial), or raise that limit"
        )
    with explained(trace, channel, failure):
        found = measure_trace(_of_pushes(trace), 1.0, channel, pressed=True)
    if characteristic_of(scene, scene.hand_on(channel)) is None:
        found = replace(found, dominant=False, reason="it is joined to another hand, or moves masses of the scene")
    m = (hand.stiffness + own) / found.k if found.dominant else math.nan
    off = m * found.k_uncertainty / found.k if found.dominant else math.nan
    return AdmittanceMeasurement(
        m=m,
        b=m * found.b - hand.damping,  # NaN with m
        m_uncertainty=off,
        b_uncertainty=math.hypot(m * found.b_uncertainty, off * found.b),
        hand=hand,
        scene_stiffness=own,
        motion=replace(found, trace=trace),
        push_n=excitation.force,
        failure=failure,
    )


def _pushed(
    run: Run, scene: Scene, channel: int, duration: float, push: float
) -> tuple[Trace, DeviceError | None, Excitation]:
    excitation = pushes(scene, channel, duration, push)
    return *recorded(run, scene, excitation, duration), excitation


def _gentle(scene: Scene, channel: int, push: float | None) -> float:
    """Returns the largest push, N: of the default or the given one, as much as accelerates the mass by a part of the
    acceleration limit."""
    mass, most = (of(scene.channels)[channel] for of in (scene.device.masses, scene.device.acceleration_limits))
    return min(largest_push(scene, push), _SHARE_OF_ACCELERATION * mass * most)


def known_hand(scene: Scene, channel: int) -> KnownHand:
    """Returns the hand on `channel` while it is measured: that of the mock, or on a port the one that the scene
    assumes. Raises UsageError if its stiffness is not known."""
    if scene.device.port is None:
        hand = scene.mock_device.hand
        stiffness, damping = (per_channel(one, scene.channels)[channel] for one in (hand.stiffness, hand.damping))
        origin, remedy = "mock.hand", "give the mock one, such as mock: {hand: {stiffness: 500 N/m}}"
    else:
        (stiffness, most), (damping, most_b), _ = scene.device.assumed_hands(scene.channels)[channel]
        origin, remedy = "device.assumed_hand", "hold the handle with a spring, and write its stiffness there"
        if (stiffness, damping) != (most, most_b):
            raise UsageError(f"{origin}: found a span, expected one hand of known stiffness and damping: {remedy}")
    if not stiffness > 0.0:
        raise UsageError(f"{origin}: found no stiffness, expected a hand that holds the handle: {remedy}")
    return KnownHand(stiffness, damping, origin)


def _of_pushes(trace: Trace) -> Trace:
    """Returns a trace whose force is the pushes alone: what the scene asks for belongs to the motion."""
    pushed = trace.force_counts * trace.force_scale - trace.asked_force
    if not np.all(np.isfinite(pushed)):
        return trace  # whose identification says so
    counts = np.rint(pushed / trace.force_scale).astype(np.int32)
    return replace(trace, force_counts=counts, asked_force=np.zeros_like(trace.asked_force))


def _links_at(scene: Scene, channel: int, trace: Trace) -> tuple[list[str], float]:
    """Returns the links at the device point that were in several states during a trace, such as a contact that was
    touched and left; and the stiffness of all of them, N/m."""
    hand = characteristic_of(scene, scene.hand_on(channel))
    if hand is None:
        return [], 0.0
    places = np.clip(np.append(trace.command[:, channel], trace.position[0, channel]), hand.low, hand.high)
    pieces = hand.pieces()
    least, most, rest = (hand.at(float(place), pieces) for place in (places.min(), places.max(), np.median(places)))
    return [name for name, state in least.states.items() if most.states[name] != state], rest.stiffness
