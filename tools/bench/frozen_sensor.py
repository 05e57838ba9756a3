"""The guard of a frozen sensor (hapsim/loop/guards/frozen_sensor.py) in simulated hands: its own compiled functions.

    tools/bench/frozen_sensor [--live 10000] [--dead 60] [--hard 200] [--seed 1] [--save FILE]

A hand is a second mass that grips the handle, on an arm that goes to a place and back, pushes and trembles. The loop is
that of one channel at 1 kHz with a delay of one sample; guard, lowering and history of forces are the exchange's own.
The device is declared at 0.2 kg with the hand; the handle alone has 0.3 to 1 of that.

**Live**: hands that press and hold for four seconds. **Dead**: the sensor dies in a flick of a free handle, while a
hand moves it, while one presses (and lets go within a second), or where it lets go. How far the handle goes until its
force is zero, and what energy it has until then; *weaker*: of runs below the force that is judged. **Hard**: what looks
like a dead sensor and is none.
"""

from __future__ import annotations

import argparse
import json
import math
import random
import sys
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np

from firmware_protocol.compiled import new_record
from hapsim.compiling import entry, helper
from hapsim.compiling.native import address_of
from hapsim.loop.buffers import IO_BUFFER
from hapsim.loop.force_history import FORCE_HISTORY, history_hook, keep
from hapsim.loop.guards.frozen_sensor import FROZEN_SENSOR, GUARD, LEAST_FORCE, judge_sensor, lower_force
from hapsim.loop.hooks import TICK, Setting, call_hook
from hapsim.scales import SCALES

RATE, STEPS, MASS, SCALE = 1000.0, 5, 0.2, 1e-4  # Hz, steps of a hand in a sample, kg declared, N per count
NEVER = 1e9  # s
COUNTS = (1e-6, 10e-6, 20e-6, 1e-4, 5e-4)
WALL, SPRING, DETENT, PUSH = range(4)

_DEVICE = ("mass", "friction", "dry", "stop", "limit", "count", "law", "stiffness", "damping", "pitch")
_HAND = ("hand", "grip", "grip_damping", "arm", "arm_damping", "goal", "reach", "hz", "push", "tremor", "tremor_hz")
_WHEN = ("position", "velocity", "dies", "released", "lasts")
RUN = np.dtype([(name, np.float64) for name in (*_DEVICE, *_HAND, *_WHEN)], align=True)
"""Random parameters of a run. SI units and s; hand 0 kg: nobody holds the handle."""
FOUND = np.dtype(
    [("faded", np.int64), ("ends", np.int64)]
    + [(name, np.float64) for name in ("lowered", "share", "moved", "way", "energy", "died_at", "zero_at", "last")],
    align=True,
)
"""Results of a run: the largest reduction of the force, in N and relative; the handle's travel during a question; its
travel with a dead sensor until zero force, and its largest energy until then."""


@helper
def _asked(run, at, speed, now):
    """The scene's force, N."""
    if run.law == WALL:
        return max(-run.stiffness * at - run.damping * speed, 0.0) if at < 0.0 else 0.0
    if run.law == SPRING:
        return -run.stiffness * at - run.damping * speed
    if run.law == DETENT:
        turn = 2.0 * math.pi / run.pitch
        return -run.stiffness / turn * math.sin(turn * at) - run.damping * speed
    return -run.stiffness if now >= 0.02 else 0.0


@helper
def _moved(run, now, h, force, x, v, hand_x, hand_v):
    """Handle and hand, a step later."""
    grip = 0.0
    if run.hand > 0.0 and now < run.released:
        grip = run.grip * (hand_x - x) + run.grip_damping * (hand_v - v)
        goal, turn = run.goal + run.reach * math.sin(2.0 * math.pi * run.hz * now), 2.0 * math.pi * run.tremor_hz
        push = run.arm * (goal - hand_x) - run.arm_damping * hand_v + run.push * min(4.0 * now, 1.0)
        hand_v += h * ((push - grip) / run.hand + run.tremor * turn * turn * math.sin(turn * now))
        hand_x += h * hand_v
    else:
        hand_x, hand_v = x, v
    total = force + grip - run.friction * v
    side = math.copysign(1.0, v if v != 0.0 else total)
    total = 0.0 if v == 0.0 and abs(total) <= run.dry else total - run.dry * side
    faster = v + h * total / run.mass
    v = 0.0 if run.dry > 0.0 and faster * v < 0.0 else faster
    x += h * v
    if run.stop > 0.0 and abs(x) > run.stop:
        x, v = math.copysign(run.stop, x), 0.0
    return x, v, hand_x, hand_v


@entry
def simulate(run, io, hooks, tick, sensor, guarded, found):
    """Runs one hand on one device."""
    period, h = 1.0 / RATE, 1.0 / RATE / STEPS
    x, v, hand_x, hand_v, acting, before, read = run.position, run.velocity, run.position, run.velocity, 0.0, 0, 0
    asked_at, dead = x, False
    found.zero_at = -1.0
    for n in range(np.int64(run.lasts * RATE)):
        now = n * period
        counts = np.int64(np.rint(x / run.count))
        if now < run.dies:
            read = counts
        elif not dead:
            read, dead, found.died_at = counts, True, x
        speed = (read - before) * run.count / period if n > 0 else 0.0
        before, at = read, read * run.count
        force = _asked(run, at, speed, now)
        force = min(max(force, -run.limit), run.limit)
        io.position_counts[0], io.asked[0], io.force_counts[0] = read, force, np.int64(np.rint(force / SCALE))
        call_hook(hooks[0], (hooks[1], tick.address))
        call_hook(hooks[2], (hooks[3], tick.address))
        if guarded and found.ends == 0:
            was = sensor.test_age[0] >= 0
            found.ends = call_hook(hooks[4], (hooks[5], tick.address)) != 0
            if sensor.test_age[0] >= 0 and not was:
                asked_at = x
        sent = io.force_counts[0] * SCALE if found.ends == 0 else 0.0
        if sensor.lowered != 0 and sensor.frozen[0] == 0:
            found.lowered = max(found.lowered, abs(force - sent))
            found.share = max(found.share, 1.0 - sensor.share[0])
            found.moved = max(found.moved, abs(x - asked_at))
        if sensor.frozen[0] and found.zero_at < 0.0:
            found.zero_at = now
            if not dead:
                found.faded = 1
        stands, acting = acting, sent  # the answer to this sample acts from the next one on
        for i in range(STEPS):
            x, v, hand_x, hand_v = _moved(run, now + i * h, h, stands, x, v, hand_x, hand_v)
        found.last = abs(force)
        if dead and (found.zero_at < 0.0 or sent != 0.0):
            found.way = max(found.way, abs(x - found.died_at))
            found.energy = max(found.energy, 0.5 * run.mass * v * v)


def simulated(drawn: dict[str, float], *, declared: dict[str, Any] | None = None, guarded: bool = True) -> Any:
    """One run: (FOUND, questions, samples without force). `declared`: what the scene declares of dry
    friction, travel and mass."""
    declared = declared or {}
    run, found = new_record(RUN), new_record(FOUND)
    for name in RUN.names:
        run[name] = drawn.get(name, 0.0)
    io, history, sensor = (new_record(one) for one in (IO_BUFFER, FORCE_HISTORY, FROZEN_SENSOR))
    tick = new_record(TICK)
    io.channels, tick.gap = 1, 1
    tick.address, tick.io, tick.history = address_of(tick), address_of(io), address_of(history)
    io.position_scale[0], io.force_scale[0], io.force_limit[0] = run.count, SCALE, run.limit
    kept = history_hook(history, delay=1.0, keeps_last_force=True)
    device = SimpleNamespace(
        scales=lambda _: [SCALES["linear"]],
        mass_spans=lambda _: [(declared.get("mass", MASS),) * 2],
        travels=lambda _: [(declared.get("low", -math.inf), declared.get("high", math.inf))],
        travel=None,
    )
    mock = SimpleNamespace(coulomb=declared.get("dry", 0.0))
    scene: Any = SimpleNamespace(channels=1, rate=RATE, device=device, mock_device=mock)
    about: Any = SimpleNamespace(position_scale=[run.count]), SimpleNamespace(soft_start_s=0.05)
    GUARD.set_up(SimpleNamespace(frozen_sensor=sensor, io=io), Setting(scene, *about, in_hand=True))
    calls = ((lower_force, sensor), (keep, history), (judge_sensor, sensor))
    hooks = [word for function, record in calls for word in (function.address(), address_of(record))]
    simulate(run, io, np.array(hooks, np.uint64), tick, sensor, guarded, found)
    assert kept.kept.size  # the history has but its address
    return found, int(sensor.tests), int(sensor.frozen_ticks)


def drawn_hand(chance: random.Random) -> dict[str, float]:
    """Draws a hand: from a finger to an arm that leans, from one that rests on the table to one that trembles."""
    return {
        "hand": 0.1 * 10.0 ** chance.random(),
        "grip": 300.0 * 10.0 ** chance.random(),
        "grip_damping": 2.0 * 10.0 ** chance.random(),
        "arm": 20.0 * 25.0 ** chance.random(),
        "arm_damping": 2.0 * 10.0 ** chance.random(),
        "reach": chance.choice((0.0, 1e-4 * 50.0 ** chance.random())),
        "hz": 0.05 * 20.0 ** chance.random(),
        "tremor": 2e-6 * 50.0 ** chance.random(),
        "tremor_hz": chance.uniform(7.0, 12.0),
        "released": NEVER,
        "dies": NEVER,
    }


def drawn_device(chance: random.Random, count: float, limit: float | None = None) -> dict[str, float]:
    damping = chance.uniform(0.0, 8.0)
    most = 0.7 * (damping + 1.0) * RATE / 1.5
    return {
        "mass": MASS * chance.uniform(0.3, 1.0),
        "friction": 1.0,
        "limit": limit or 10.0 ** chance.random(),
        "count": count,
        "stiffness": 300.0 * (max(most, 330.0) / 300.0) ** chance.random(),
        "damping": damping,
    }


def _wall(chance: random.Random, one: dict[str, float]) -> dict[str, Any]:
    one |= {"law": WALL, "push": -one["limit"] * chance.uniform(0.1, 0.9), "position": chance.uniform(0.0, 0.005)}
    return {}


def _spring(chance: random.Random, one: dict[str, float]) -> dict[str, Any]:
    one |= {"law": SPRING, "goal": chance.uniform(-0.02, 0.02)}
    return {}


def _push(chance: random.Random, one: dict[str, float]) -> dict[str, Any]:
    weight = one["limit"] * chance.uniform(0.05, 0.9)
    one |= {"law": PUSH, "stiffness": weight, "push": weight}
    return {}


def _stop(chance: random.Random, one: dict[str, float]) -> dict[str, Any]:
    """The scene presses the handle against a declared end, where a hand rests on it or nobody does."""
    one |= {"law": PUSH, "stiffness": one["limit"] * chance.uniform(0.05, 0.9), "stop": 0.01, "position": -0.01}
    if chance.random() < 0.5:
        one["hand"] = 0.0
    return {"low": -0.0099}


def _dry(chance: random.Random, one: dict[str, float]) -> dict[str, Any]:
    dry = one["limit"] * 0.02 * 10.0 ** chance.random()
    _wall(chance, one)
    one["dry"] = dry
    return {"dry": dry}


def _detent(chance: random.Random, one: dict[str, float]) -> dict[str, Any]:
    """At rest in a detent, with the hand on it or held a little off."""
    pitch = chance.uniform(0.002, 0.01)
    one |= {"law": DETENT, "pitch": pitch, "goal": chance.choice((0.0, chance.uniform(-0.3, 0.3))) * pitch}
    one["dry"] = one["limit"] * chance.uniform(0.0, 0.02)
    return {"dry": one["dry"]}


KINDS: dict[str, Callable[[random.Random, dict[str, float]], dict[str, Any]]] = {
    "wall": _wall,
    "spring": _spring,
    "weight held": _push,
    "declared stop": _stop,
    "declared dry friction": _dry,
    "detent": _detent,
}


def live(number: int, seed: int, count: float) -> dict[str, Any]:
    """Hands on sensors that live: how many feel a question, of how much, and how many a fade."""
    each, of_kind, runs = max(number // len(KINDS), 1), {}, []
    for kind, draw in KINDS.items():
        mine = []
        for i in range(each):
            chance = random.Random(f"{seed} {kind} {i}")
            one = drawn_device(chance, count) | drawn_hand(chance) | {"lasts": 4.0}
            mine.append(simulated(one, declared=draw(chance, one)))
        of_kind[kind] = [sum(tests > 0 for _, tests, _ in mine), sum(frozen > 0 for _, _, frozen in mine)]
        runs += mine
    asked = [found for found, tests, _ in runs if tests]
    return {
        "runs": len(runs),
        "asked": len(asked),
        "questions of an asked run": _spread([tests for _, tests, _ in runs if tests]),
        "faded": sum(frozen > 0 for _, _, frozen in runs),
        "for, ms": _spread([1e3 * frozen / RATE for _, _, frozen in runs if frozen]),
        "ended": sum(int(found.ends) for found, _, _ in runs),
        "lowered by, N": _spread([found.lowered for found in asked]),
        "of itself": _spread([found.share for found in asked]),
        "moved, mm": _spread([1e3 * found.moved for found in asked]),
        "asked, faded by kind": of_kind,
    }


def _flick(chance: random.Random, one: dict[str, float]) -> None:
    """Nobody holds the handle; it dies within the first two swings."""
    one |= {
        "law": chance.choice((WALL, SPRING)),
        "velocity": -chance.uniform(0.05, 0.6),
        "dies": chance.uniform(0, 0.2),
    }
    one["hand"] = 0.0


def _moving(chance: random.Random, one: dict[str, float]) -> None:
    """A hand moves it to and fro, and lets go when it dies."""
    one |= {"law": SPRING, "reach": 0.005 * 10.0 ** chance.random(), "hz": 0.3 * 10.0 ** chance.random()}
    one["dies"] = one["released"] = chance.uniform(0.3, 2.0)


def _later(chance: random.Random, one: dict[str, float]) -> None:
    """A hand presses steadily, and lets go up to a second after it died."""
    one |= {"law": WALL, "push": -one["limit"] * chance.uniform(0.3, 0.9), "dies": chance.uniform(0.5, 2.0)}
    one["released"] = one["dies"] + chance.uniform(0.0, 1.0)


def _released(chance: random.Random, one: dict[str, float]) -> None:
    """A hand presses steadily, and releases the handle in the sample in which it dies."""
    _later(chance, one)
    one["released"] = one["dies"]


MOMENTS = {"in a flick": _flick, "moved": _moving, "pressed, released later": _later, "released": _released}


def dead(number: int, seed: int, moment: str, limit: float, mass: float, count: float) -> dict[str, Any]:
    """Returns the handle's travel until its force is zero, in mm, and its energy until then, in J."""
    runs = []
    for i in range(number):
        chance = random.Random(f"{seed} {moment} {i}")
        one = drawn_device(chance, count, limit) | drawn_hand(chance) | {"lasts": 5.0}
        one |= {"mass": mass, "stiffness": min(one["stiffness"], 0.5 * RATE**2 * mass / 10)}
        MOMENTS[moment](chance, one)
        runs.append(simulated(one, declared={"mass": mass})[0])
    strong = [one for one in runs if one.last > LEAST_FORCE * limit]
    weak = [one.energy for one in runs if one.last <= LEAST_FORCE * limit]
    return {
        "runs": len(strong),
        "mm": _spread([1e3 * one.way for one in strong]),
        "J": _spread([one.energy for one in strong]),
        "not zero": sum(bool(one.zero_at < 0.0) for one in strong),
        "weaker, J at most": round(float(max(weak, default=0.0)), 3),
    }


def hard(number: int, seed: int) -> dict[str, Any]:
    """Returns the number of questions and of fades in runs that resemble a dead sensor."""
    table: dict[str, Any] = {}
    for count in (1e-6, 1e-4, 5e-4):
        for name, kind in (("a stop", _stop), ("dry friction", _dry), ("dry detent", _detent)):
            asked = faded = 0
            for i in range(number):
                chance = random.Random(f"{seed} {name} {i}")
                one = drawn_device(chance, count) | drawn_hand(chance) | {"lasts": 4.0}
                kind(chance, one)
                if kind is _detent:  # nobody holds it: dry friction keeps it off its rest
                    one |= {"hand": 0.0, "dry": 0.1 * one["limit"], "position": 0.01 * one["pitch"]}
                _, times, frozen = simulated(one)
                asked, faded = asked + (times > 0), faded + (frozen > 0)
            table[f"{name}, not declared, {1e6 * count:g} µm"] = {"runs": number, "asked": asked, "faded": faded}
    return table


def _spread(values: list[float]) -> list[float]:
    """The median, 95 in a hundred, and the most."""
    return [float(f"{one:.3g}") for one in np.quantile(values, (0.5, 0.95, 1.0))] if values else []


def main() -> int:
    parser = argparse.ArgumentParser("tools/bench/frozen_sensor", description=__doc__)
    for name, default in (("live", 10_000), ("dead", 60), ("hard", 200), ("seed", 1)):
        parser.add_argument(f"--{name}", type=int, default=default)
    parser.add_argument("--save", type=Path)
    asked = parser.parse_args()
    result: dict[str, Any] = {"live": {}, "dead": {}}
    for count in COUNTS:
        one = result["live"][f"{1e6 * count:g} µm"] = live(asked.live // len(COUNTS), asked.seed, count)
        print(f"{1e6 * count:g} µm: {one}", flush=True)
    for moment in MOMENTS:
        for limit in (1.0, 10.0, 40.0):
            for mass in (0.05, 0.2, 1.0):
                for count in (1e-6, 20e-6, 1e-4):
                    one = dead(asked.dead, asked.seed, moment, limit, mass, count)
                    name = f"{moment}, {limit:g} N, {mass:g} kg, {1e6 * count:g} µm"
                    result["dead"][name] = one
                    print(f"{name}: {one}", flush=True)
    result["hard"] = hard(asked.hard, asked.seed)
    for name, one in result["hard"].items():
        print(f"{name}: {one}")
    if asked.save:
        asked.save.write_text(json.dumps(result, indent=1) + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
