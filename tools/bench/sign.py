"""The guard of the sign (hapsim/loop/guards/sign.py) in simulated hands: the compiled loop and the mock in lockstep.

    tools/bench/sign [--runs 400] [--right 10000] [--at-stop 4000] [--rate 1000] [--seed 1] [--only lines | counts]
        [--save FILE]

A hand is a second mass on the handle, an arm that holds it and moves it, tremor, knocks, and leaning; or
the handle flies freely. A hand can also lean on a mechanical stop, just behind the wall. The hand's mass and stiffness,
the wall, the encoder, noise and a stall are drawn. Every run lasts a second, with the guards of a port. How far and how
fast the handle moves is counted from the first force to 0.1 m.

In the plane a hand wanders, circles or flicks the handle, for three seconds, on a spring, about a disc, in a box with a
wall and on a ring; a violent one also knocks, pushes with up to 30 N, or is a second mass on a handle of 0.1 to 0.4 kg.

A run is the loop that `hapsim run` runs: the mock moves its body by a function of this file, in which the hand is.
What a run left behind in memory is put back by copying what was there after arming.
"""

from __future__ import annotations

import argparse
import ctypes
import json
import math
import random
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numba import types

from hapsim.compiling.native import address_of, native, record_at
from hapsim.device.connection import Connection, arm, describe
from hapsim.device.mock.assemble_mock import assemble_mock
from hapsim.device.mock.motion import BODY
from hapsim.device.mock.record import call_event, mock_at
from hapsim.device.mock.wire import loopback_transport
from hapsim.loop.compiled_loop import run_loop
from hapsim.loop.guards import in_words
from hapsim.running.assemble_loop import assemble_loop
from hapsim.running.requirements import PACING
from hapsim.running.session_options import RunOptions
from hapsim.scene import parse_scene

STEPS = 5  # of a hand, in a sample
KNOCKS = 4
KINDS = ("thrown", "held", "knocked", "leaning")
AT_STOP = ("thrown at a stop", "held at a stop", "knocked at a stop", "leaning at a stop")
RIGHT, SWAPPED = np.eye(2), np.array([[0.0, 1.0], [1.0, 0.0]])
FAULTS: dict[str, Any] = {
    "right": 1.0,
    "inverted": -1.0,
    "10 times the force": 10.0,
    "a tenth of it": 0.1,
    "swapped channels": SWAPPED,
}
"""The force that the motors make of one, by channel."""


def turn(degrees: float) -> Any:
    """Motors of a hand in the plane that are turned."""
    c, s = math.cos(math.radians(degrees)), math.sin(math.radians(degrees))
    return np.array([[c, -s], [s, c]])


PAIRS: dict[str, Any] = {
    "right": RIGHT,
    "x inverted": np.diag([-1.0, 1.0]),
    "both inverted": -RIGHT,
    "exchanged": SWAPPED,
    **{f"turned by {degrees}": turn(degrees) for degrees in (90, -90, 120, 60, 45, 30)},
}
USUAL, VIOLENT = ("wandering", "circling", "wandering", "flicked"), ("knocked", "pushing", "heavy", "wandering")
FAR_M, NEAR_M = 0.05, 0.03  # a run that goes so far is a runaway; and one is stopped soon
END_M = 0.1  # the end of travel: what comes behind it does not count,
COUNTS = ((1e-6,), (1e-5, 2e-5), (1e-4,))  # m, of hands in the plane
PLANE_S, PLANE_END_M, LOST_M = 3.0, 0.5, 0.3  # and in the plane, where a hand that goes so far is lost
_FIELDS = ("mass", "stiffness", "damping", "arm_stiffness", "arm_damping", "reach", "hz", "phase")
_PUSHES = ("tremor", "tremor_hz", "lean", "lean_rate", "lean_from", "lean_until")
_STOP = ("stop_behind", "stop_stiffness", "stop_damping")  # m from the origin, N/m (0: there is none), N·s/m

HAND = np.dtype(
    [(name, np.float64) for name in (*_FIELDS, *_PUSHES, *_STOP)]
    + [(name, np.float64, (KNOCKS,)) for name in ("knock_at", "knock_lasts", "knock")]
    + [("home", np.float64), ("position", np.float64), ("velocity", np.float64), ("time", np.float64)]
    + [("other", np.uint64)]  # address of the hand's other channel in the plane; of one that rests on a line
    + [("force", np.float64), ("least_force", np.float64), ("touched", np.int64), ("begun_at", np.float64)]
    + [("way", np.float64), ("end", np.float64), ("most_m", np.float64), ("most_m_per_s", np.float64)],
    align=True,
)
"""A hand on a channel, and how far and how fast its handle was since the first force."""

_hand_at, _body_at = record_at(HAND), record_at(BODY)


@native(types.void, types.uint64, types.float64, types.float64)
def move_in_hand(body, force, h):
    """Moves a mock's body that a hand holds. Its dry friction says where the hand is in memory."""
    body = _body_at(body)
    hand = _hand_at(np.uint64(body.coulomb))
    other = _hand_at(hand.other)
    hand.force = force
    if hand.touched == 0 and math.hypot(force, other.force) > hand.least_force:
        hand.touched, hand.begun_at = 1, body.position
    step = h / STEPS
    for _ in range(STEPS):
        at = hand.position if hand.mass > 0.0 else body.position
        speed = hand.velocity if hand.mass > 0.0 else body.velocity
        turn = 2.0 * math.pi * hand.time
        reach = hand.reach * (math.sin(hand.hz * turn + hand.phase) - math.sin(hand.phase))
        push = hand.arm_stiffness * (hand.home + reach - at) - hand.arm_damping * speed
        push += hand.tremor * math.sin(hand.tremor_hz * turn)
        for i in range(KNOCKS):
            since = hand.time - hand.knock_at[i]
            if 0.0 <= since < hand.knock_lasts[i]:
                push += hand.knock[i] * math.sin(math.pi * since / hand.knock_lasts[i])
        if hand.lean_from < hand.time < hand.lean_until:
            push -= min(hand.lean, hand.lean_rate * (hand.time - hand.lean_from))
        on_handle = push
        if hand.mass > 0.0:
            on_handle = hand.stiffness * (at - body.position) + hand.damping * (speed - body.velocity)
            hand.velocity += step * (push - on_handle) / hand.mass
            hand.position += step * hand.velocity
        into_stop = -hand.stop_behind - body.position
        if hand.stop_stiffness > 0.0 and into_stop > 0.0:
            on_handle += max(hand.stop_stiffness * into_stop - hand.stop_damping * body.velocity, 0.0)
        body.velocity += step * (force - body.friction * body.velocity + on_handle) / body.mass
        body.position += step * body.velocity
        hand.time += step
    hand.way = body.position - hand.begun_at if hand.touched else 0.0
    if hand.touched and hand.most_m < hand.end:
        hand.most_m = max(hand.most_m, math.hypot(hand.way, other.way))
        hand.most_m_per_s = max(hand.most_m_per_s, abs(body.velocity))


@native(types.void, types.uint64, types.int64)
def take_force_unless_stalled(mock, now):
    """Applies a force in virtual time, or too late while the host stalls: what the motors make of it. The stall is in
    the mock's first frame under way, which a wire in memory does not use, and the motors are in its coupling."""
    address, mock = mock, mock_at(mock)
    asked, made, motors = mock.coupling.force, mock.decoder.counts, mock.coupling.inverse
    for c in range(mock.channels):
        asked[c] = made[c]
    for c in range(mock.channels):
        force = 0.0
        for one in range(mock.channels):
            force += motors[c, one] * asked[one]
        made[c] = np.int64(force)
    n, stall = mock.board.n, mock.under_way[0]
    if stall.number <= n < stall.argument:
        call_event(mock.called.take_sample, (address, now))
    else:
        call_event(mock.called.act_on_force, (address, now))


class Outcome(NamedTuple):
    """Result of a run."""

    kind: str
    ending: str
    channel: int
    most_m: float
    most_m_per_s: float
    ticks: int
    tests: int
    forced: bool

    @property
    def is_found(self) -> bool:
        """True if the sign guard ended the run."""
        return self.ending == "sign wrong"


def drawn_scene(
    chance: random.Random, *, rate: float, force_limit: float, mass: float, channels: int = 1, count: float = 0.0
) -> Any:
    """A wall, or a spring to both sides, well within what is stable, before a random encoder, or one with this
    `count`, m."""
    damping = chance.uniform(0.0, 8.0)
    most = 0.7 * (damping + 1.0) * rate / 1.5 * min(1.0, mass / 0.2)
    is_wall = chance.random() < 0.6
    link: dict[str, Any] = {"type": "buffer" if is_wall else "viscoelastic", "damping": damping}
    link["stiffness"] = 300.0 * (max(most, 330.0) / 300.0) ** chance.random()
    modules: dict[str, Any] = {"wall": {"type": "ground"}}
    for c in range(channels):
        modules[f"hand{c}"] = {"type": "device", "channel": c}
        modules[f"touch{c}"] = {
            "type": "buffer" if is_wall else "viscoelastic",
            "between": [f"hand{c}", "wall"],
            **link,
        }
    device = {"clock": "lockstep", "mass": mass, "friction": 1.0, "force_limit": force_limit}
    device |= {"slew_limit": 1e3 * force_limit, "soft_start": 0.05, "energy_limit": 0.02 * force_limit}
    mock = {
        "quantum": chance.choice((1e-6, chance.uniform(1e-7, 24e-6))),
        "noise": chance.choice((0.0, chance.uniform(0.0, 5e-6))),
        "initial": {"position": chance.uniform(0.002, 0.012) if is_wall else 0.0},
    }
    if count:
        mock |= {"quantum": count, "noise": 0.0}
    document = {"version": 1, "rate": rate, "device": device, "mock": mock, "modules": modules}
    return parse_scene(json.dumps(document), "random scene")


def plane_scene(form: dict[str, Any], *, rate: float, force_limit: float, mass: float, count: float) -> Any:
    """A hand in the plane, and what `form` has of FORMS."""
    modules: dict[str, Any] = {"hand": {"type": "device", "channels": [0, 1]}}
    for i, one in enumerate(form["shapes"]):  # with its own ground: the material of a ring's two discs is everywhere
        modules[f"board{i}"] = {"type": "ground", "position": [0.0, 0.0]}
        modules[f"shape{i}"] = {"type": "shape", "between": ["hand", f"board{i}"], **one}
    device = {"clock": "lockstep", "mass": mass, "friction": 1.0, "force_limit": force_limit}
    device |= {"slew_limit": 1e3 * force_limit, "soft_start": 0.05, "energy_limit": 0.02 * force_limit}
    document = {"version": 1, "rate": rate, "space": 2, "device": device, "modules": modules}
    document["mock"] = {"quantum": count, "initial": {"position": form.get("start", [0.0, 0.0])}}
    return parse_scene(json.dumps(document), "scene in the plane")


FORMS: tuple[dict[str, Any], ...] = (
    {"shapes": [{"form": {"disc": 0.001}, "side": "inside", "stiffness": 1000.0, "damping": 3.0}]},
    {
        "start": [-0.03, 0.0],
        "shapes": [{"form": {"disc": 0.02}, "side": "outside", "stiffness": 2000.0, "damping": 5.0}],
    },
    {
        "shapes": [
            {"form": {"box": [0.08, 0.06]}, "side": "inside", "stiffness": 1200.0, "damping": 4.0},
            {
                "form": {"capsule": [[-0.022, -0.030], [-0.022, 0.010]], "radius": 0.002},
                "stiffness": 1200.0,
                "damping": 4.0,
            },
        ]
    },
    {
        "start": [-0.03, 0.0],
        "shapes": [
            {"form": {"disc": 0.03}, "side": side, "stiffness": 1500.0, "damping": 4.0}
            for side in ("inside", "outside")
        ],
    },
)
"""A spring to the middle, a disc, a box with a wall, and a ring on which the hand is held."""


class Bench:
    """A scene, armed before its mock, that can be run again and again."""

    def __init__(self, scene: Any, duration: float = 1.0) -> None:
        self.scene = scene
        self._mock = mock = assemble_mock(scene)
        mock.called.take_force = take_force_unless_stalled.address()
        self._connection = Connection(transport=loopback_transport(mock), name="mock", close=lambda: None)
        mock.called.move = move_in_hand.address()
        description = describe(self._connection)
        options = RunOptions(duration=duration, judges_energy=True, judges_sign=True)
        self._loop = assemble_loop(scene, self._connection, description, options)
        arm(self._connection, description, PACING["lockstep"], self._loop.watchdog_samples, False)
        self._hands = np.zeros(scene.channels + 1, HAND)  # the last one rests
        (forces,) = (hook.kept for hook in self._loop.hooks if hook.kept is not None)
        self._memory = [
            (address_of(one), one.nbytes) for one in (self._loop.record, mock, self._connection.inbox, forces)
        ]
        self._after_arming = [ctypes.string_at(*one) for one in self._memory]

    def run(
        self, chance: random.Random, kind: str, *, motors: Any = 1.0, judged: bool = True, known: bool = False
    ) -> Outcome:
        """A run in a hand of this kind. `motors`: of FAULTS or PAIRS; `known`: they were acquitted before."""
        for (address, size), before in zip(self._memory, self._after_arming, strict=True):
            ctypes.memmove(address, before, size)
        record, mock, channels = self._loop.record, self._mock, self.scene.channels
        self._hands[:] = np.zeros(1, HAND)
        if self.scene.space > 1:
            self._grip_in_plane(chance, kind)
        else:
            for c in range(channels):
                self._grip(c, chance, kind if c == 0 else "thrown")
        mock.coupling.inverse[:channels, :channels] = motors * np.eye(channels) if np.ndim(motors) < 2 else motors
        mock.force_limit[:channels] *= 100.0
        if chance.random() < 0.3:
            stall = mock.under_way[0]
            stall.number = int(self.scene.rate * chance.random())
            stall.argument = stall.number + max(2, int(self.scene.rate * chance.uniform(0.002, 0.047)))
        record.control.go = 1
        record.sign.plans[:] = not known
        if not judged:
            record.sign.is_over = 1
        ending = in_words(run_loop(record))
        far, fast = self._hands["most_m"].max(), self._hands["most_m_per_s"].max()
        sign, forced = record.sign, bool(self._hands["touched"].any())
        ticks = int(record.state.ticks)
        return Outcome(kind, ending, int(sign.channel), float(far), float(fast), ticks, int(sign.tests), forced)

    @property
    def record(self) -> Any:
        """LOOP after the last run."""
        return self._loop.record

    def _hold(self, c: int, other: int, end: float) -> Any:
        """Returns the hand on a channel, whose body it moves. `other`: that of the other channel."""
        hand, body = self._hands[c], self._mock.bodies[c]
        hand["other"] = address_of(self._hands[other : other + 1])
        hand["least_force"], hand["end"] = 0.02 * self.scene.device.force_limit, end
        hand["home"] = hand["position"] = float(body.position)
        body.coulomb = float(address_of(self._hands[c : c + 1]))
        return hand

    def _grip(self, c: int, chance: random.Random, kind: str) -> None:
        hand, body = self._hold(c, self.scene.channels, END_M), self._mock.bodies[c]
        if kind in AT_STOP:
            kind = kind.removesuffix(" at a stop")
            hand["stop_behind"] = chance.uniform(0.0, 0.004)
            hand["stop_stiffness"] = 2e3 * 20.0 ** chance.random() * min(1.0, float(body.mass) / 0.2)
            hand["stop_damping"] = 0.3 * chance.random() * 2.0 * math.sqrt(hand["stop_stiffness"] * body.mass)
        self._mock.converters[c].state = np.uint64(chance.getrandbits(63) | 1)
        self._mock.converters[c].state = np.uint64(chance.getrandbits(63) | 1)
        if kind == "thrown":
            body.velocity = -chance.uniform(0.03, 0.63)
            return
        for name, value in _drawn_hand(chance, kind).items():
            hand[name] = value
        if hand["mass"] > 0.0:  # the declared mass is that of handle and hand
            body.mass *= chance.uniform(0.3, 1.0)

    def _grip_in_plane(self, chance: random.Random, kind: str) -> None:
        """Both axes of a hand: alike, but each with its own motion."""
        drawn, axes = _drawn_hand_in_plane(chance, kind)
        side, speed = chance.uniform(0.0, 2.0 * math.pi), chance.uniform(0.05, 0.8)
        scale = 2.0 ** chance.uniform(-1.0, 1.0) if kind in VIOLENT else 1.0
        for c in (0, 1):
            hand, body = self._hold(c, 1 - c, PLANE_END_M), self._mock.bodies[c]
            for name, value in (drawn | axes[c]).items():
                hand[name] = value
            body.velocity = hand["velocity"] = speed * (math.cos(side) if c == 0 else math.sin(side))
            body.mass *= scale


def _drawn_hand(chance: random.Random, kind: str) -> dict[str, Any]:
    """Draws the non-zero parameters of a HAND."""
    drawn: dict[str, Any] = {"tremor": chance.uniform(0.0, 0.5), "tremor_hz": chance.uniform(8.0, 12.0)}
    if kind == "held" or chance.random() < 0.6:  # a second mode
        drawn |= {"mass": 0.2 * 5.0 ** chance.random(), "stiffness": 300.0 * 10.0 ** chance.random()}
        drawn |= {"damping": 2.0 * 10.0 ** chance.random()}
    if chance.random() < 0.7:
        drawn |= {"arm_stiffness": 20.0 * 25.0 ** chance.random(), "arm_damping": 2.0 * 10.0 ** chance.random()}
        drawn |= {
            "reach": chance.uniform(0.0, 0.05),
            "hz": 0.3 * 15.0 ** chance.random(),
            "phase": chance.uniform(0, 6),
        }
    if kind == "knocked":
        number = chance.randint(1, KNOCKS)
        sides = [chance.choice((-1.0, 1.0)) for _ in range(number)]
        rest = (0.0,) * (KNOCKS - number)
        drawn["knock_at"] = (*(chance.uniform(0.0, 0.9) for _ in sides), *rest)
        drawn["knock_lasts"] = (*(0.001 * 15.0 ** chance.random() for _ in sides), *rest)
        drawn["knock"] = (*(side * 5.0 * 20.0 ** chance.random() for side in sides), *rest)
    elif kind == "leaning":
        drawn |= {"lean": chance.uniform(5.0, 30.0), "lean_rate": 50.0 * 60.0 ** chance.random()}
        drawn |= {"lean_from": chance.uniform(0.0, 0.3), "lean_until": chance.uniform(0.4, 1.0)}
    return drawn


def _drawn_hand_in_plane(chance: random.Random, kind: str) -> tuple[dict[str, Any], tuple[dict[str, Any], ...]]:
    """Draws the non-zero parameters of a hand in the plane, and those of each of its axes."""
    axes: list[dict[str, Any]]
    is_free = kind == "flicked" or (kind in VIOLENT and chance.random() < 0.15)
    stiffness = 0.0 if is_free else 10.0 * 80.0 ** chance.random()
    drawn = {"arm_stiffness": stiffness, "arm_damping": 2.0 * math.sqrt(0.2 * stiffness) * chance.uniform(0.1, 1.0)}
    drawn |= {"tremor": stiffness * 1e-5 * 10.0 ** chance.random(), "tremor_hz": chance.uniform(8.0, 12.0)}
    if kind == "pushing":
        drawn |= {"tremor": chance.uniform(0.0, 30.0), "tremor_hz": chance.uniform(0.3, 3.0)}
    if kind == "heavy" and not is_free:
        drawn |= {"mass": chance.uniform(0.2, 1.0), "stiffness": 300.0 * 16.0 ** chance.random()}
        drawn["damping"] = 0.2 * math.sqrt(drawn["stiffness"] * drawn["mass"])
    if kind == "circling" or (kind in VIOLENT and chance.random() < 0.25):
        phase, quarter = chance.uniform(0.0, 2.0 * math.pi), chance.choice((-0.5, 0.5)) * math.pi
        reach = chance.uniform(0.01, 0.035)
        drawn |= {"reach": reach, "hz": 0.5 * 8.0 ** chance.random()}
        axes = [{"phase": one, "home": reach * math.sin(one)} for one in (phase + quarter, phase)]  # about the middle
    else:
        drawn["reach"] = chance.uniform(0.003, 0.03)
        axes = [{"hz": chance.uniform(0.3, 3.0), "phase": chance.uniform(0.0, 2.0 * math.pi)} for _ in (0, 1)]
    if kind == "knocked":
        at, lasts = sorted(chance.uniform(0.3, 2.9) for _ in range(KNOCKS)), 0.003 + 0.012 * chance.random()
        most = chance.uniform(0.0, 100.0)
        knocks = [(most * chance.random(), chance.uniform(0.0, 2.0 * math.pi)) for _ in at]
        drawn |= {"knock_at": at, "knock_lasts": (lasts,) * KNOCKS}
        for axis, part in zip(axes, (math.cos, math.sin), strict=True):
            axis["knock"] = [force * part(side) for force, side in knocks]
    return drawn, tuple(axes)


def runs(
    number: int, seed: int, *, each: int = 5, scene: dict[str, Any], kinds: tuple[str, ...] = KINDS, **how: Any
) -> Iterator[Outcome]:
    """The runs, `each` of them on one scene; a seed draws the same scenes, hands and stalls whatever is wrong. In the
    plane the scenes are those of FORMS, with each of `counts` (m)."""
    chance, in_plane = random.Random(seed), "counts" in scene
    for first in range(0, number, each):
        if in_plane:
            turn, others = first // each, {key: value for key, value in scene.items() if key != "counts"}
            count = scene["counts"][turn // len(FORMS) % len(scene["counts"])]
            bench = Bench(plane_scene(FORMS[turn % len(FORMS)], count=count, **others), PLANE_S)
        else:
            bench = Bench(drawn_scene(chance, **scene))
        for one in range(first, min(first + each, number)):
            yield bench.run(random.Random(f"{seed} {one}"), kinds[one % len(kinds)], **how)


def wrong(number: int, seed: int, *, scene: dict[str, Any], **how: Any) -> dict[str, Any]:
    """Returns the travel and speed of the handle of a faulty device. For runs that go far without this guard, counts
    each ending with it."""
    before = list(runs(number, seed, scene=scene, judged=False, **how))
    after = list(runs(number, seed, scene=scene, **how))
    ended = [two for one, two in zip(before, after, strict=True) if one.most_m > FAR_M]
    return {
        "runs": number,
        "m": _spread([one.most_m for one in after]),
        "m/s": _spread([one.most_m_per_s for one in after]),
        "before, m": _spread([one.most_m for one in before]),
        "before, m/s": _spread([one.most_m_per_s for one in before]),
        "stopped by the sign": sum(one.is_found for one in after),
        "stopped by other guards": sum(one.ending != "done" and not one.is_found for one in after),
        "runaways": len(ended),
        "of these by the sign": _share(one.is_found for one in ended),
        "of these within 3 cm": _share(one.ending != "done" and one.most_m <= NEAR_M for one in ended),
        **found_of_forced(after),
    }


def found_of_forced(ended: list[Outcome]) -> dict[str, Any]:
    """Returns how many of the runs in which force acted were stopped, and within which way of the first force."""
    forced = [one for one in ended if one.forced]
    ways = [one.most_m for one in forced if one.is_found]
    return {
        "forced": len(forced),
        "stopped of forced": _share(one.is_found for one in forced),
        "m until stopped: median, 95 %, most": _spread(ways, (0.5, 0.95, 1.0)),
        "lost": sum(one.most_m > LOST_M for one in forced),
    }


def right(
    number: int, seed: int, *, scene: dict[str, Any], kinds: tuple[str, ...] = KINDS, each: int = 5
) -> dict[str, Any]:
    """Returns the number of stops and of test releases on a correct device."""
    ended = list(runs(number, seed, each=each, scene=scene, kinds=kinds))
    return {
        "runs": number,
        "forced": sum(one.forced for one in ended),
        "stopped": {kind: sum(one.is_found for one in ended if one.kind == kind) for kind in kinds},
        "by other guards": sum(one.ending not in ("done", "sign wrong") for one in ended),
        "tests": sum(one.tests for one in ended),
        "most tests in a run": max(one.tests for one in ended),
    }


def _share(hits: Any) -> float:
    found = list(hits)
    return sum(found) / len(found) if found else math.nan


def _spread(values: list[float], shares: tuple[float, ...] = (0.5, 0.9, 1.0)) -> list[float]:
    """The median, nine in ten, and the most."""
    return [round(float(one), 4) for one in np.quantile(values, shares)] if values else []


def lines(asked: argparse.Namespace) -> dict[str, Any]:
    """Prints and returns what becomes of faulty devices on a line."""
    found: dict[str, Any] = {}
    print("| device | N | kg | m: median, 90 %, most | m/s | without this guard: m | m/s |", end=" ")
    print("stopped: sign, other | runaways | of these: sign | within 3 cm |\n|" + "---|" * 11)
    for what, motors in FAULTS.items():
        for force, mass in [(force, mass) for force in (2.5, 10.0, 40.0) for mass in (0.05, 0.2, 1.0)]:
            channels = 2 if what.startswith("swapped") else 1
            scene = {"rate": asked.rate, "force_limit": force, "mass": mass, "channels": channels}
            one = found[f"{what}, {force:g} N, {mass:g} kg"] = wrong(asked.runs, asked.seed, scene=scene, motors=motors)
            cells = (", ".join(f"{x:.2g}" for x in one[name]) for name in ("m", "m/s", "before, m", "before, m/s"))
            shares = (f"{one[name]:.0%}" for name in ("of these by the sign", "of these within 3 cm"))
            stopped = f"{one['stopped by the sign']}, {one['stopped by other guards']}"
            row = (what, f"{force:g}", f"{mass:g}", *cells, stopped, str(one["runaways"]), *shares)
            print(f"| {' | '.join(row)} |", flush=True)
    return found


def by_count(asked: argparse.Namespace) -> dict[str, Any]:
    """Prints and returns what becomes of faulty and of right devices whose positions have these counts, at 10 N and
    0.2 kg, on a line and in the plane."""
    found: dict[str, Any] = {}
    firm = {"rate": asked.rate, "force_limit": 10.0, "mass": 0.2}
    print(
        "\n| device | count | forced runs | stopped | m until then: median, 95 %, most | beyond 0.3 m |\n|" + "---|" * 6
    )
    faulty: list[tuple[str, Any, str, Any]]
    faulty = [("a line, inverted", -1.0, "count", count) for count in (1e-6, 2e-5, 5e-5, 1e-4, 2e-4)]
    faulty += [
        (what, motors, "counts", counts) for counts in COUNTS for what, motors in PAIRS.items() if what != "right"
    ]
    for what, motors, key, count in faulty:
        of_hand = KINDS if key == "count" else USUAL
        ended = runs(asked.runs, asked.seed, each=20, scene={**firm, key: count}, kinds=of_hand, motors=motors)
        one = found[f"{what}, {_in_um(count)}"] = found_of_forced(list(ended))
        ways = ", ".join(f"{x:.2g}" for x in one["m until stopped: median, 95 %, most"])
        row = (what, _in_um(count), str(one["forced"]), f"{one['stopped of forced']:.0%}", ways, str(one["lost"]))
        print(f"| {' | '.join(row)} |", flush=True)
    kinds: tuple[str, ...]
    tried: list[tuple[str, str, Any, tuple[str, ...]]] = [("a line", "count", 1e-4, KINDS)]
    tried += [("a pair", "counts", counts, kinds) for counts in COUNTS for kinds in (USUAL, VIOLENT)]
    for where, key, count, kinds in tried:
        name = f"right, {where}, {_in_um(count)}, {'usual' if kinds is USUAL else 'violent'}"
        one = found[name] = right(asked.right // 5, asked.seed + 3, scene={**firm, key: count}, kinds=kinds, each=20)
        print(f"\n{name}: {one}", flush=True)
    return found


def _in_um(count: Any) -> str:
    return " and ".join(f"{1e6 * one:g}" for one in np.atleast_1d(count)) + " µm"


def main() -> int:
    parser = argparse.ArgumentParser("tools/bench/sign", description=__doc__)
    parser.add_argument("--runs", type=int, default=400)
    parser.add_argument("--right", type=int, default=10_000)
    parser.add_argument("--at-stop", type=int, default=4000)
    parser.add_argument("--rate", type=float, default=1000.0)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--only", choices=("lines", "counts"))
    parser.add_argument("--save", type=Path)
    asked = parser.parse_args()
    found: dict[str, Any] = {}
    if asked.only != "counts":
        found |= lines(asked)
        if asked.right:
            scene = {"rate": asked.rate, "force_limit": 10.0, "mass": 0.2}
            one = found["false stops, 10 N, 0.2 kg"] = right(asked.right, asked.seed + 1, scene=scene)
            print(f"\nright: {one}")
        for rate, mass in ((1000.0, 0.2), (1000.0, 0.05), (5000.0, 0.2)) if asked.at_stop else ():
            scene = {"rate": rate, "force_limit": 10.0, "mass": mass}
            name = f"false stops at a mechanical stop, 10 N, {mass:g} kg, {rate:g} Hz"
            one = found[name] = right(asked.at_stop, asked.seed + 2, scene=scene, kinds=AT_STOP)
            print(f"\n{name}: {one}", flush=True)
    if asked.only != "lines":
        found |= by_count(asked)
    if asked.save:
        asked.save.write_text(json.dumps(found, indent=1) + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
