"""Random scenes of the kinds whose verdicts are hard to give, and the referee: the mock pushed in virtual time, which
knows nothing of the prediction."""

from __future__ import annotations

import random
from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import numpy as np
import yaml

from hapsim.errors import GuardError
from hapsim.running.run import run_in_memory
from hapsim.scene import Scene, parse_scene

Modules = dict[str, Any]
LIMIT = 10.0  # N, of the force
_LEAST = 2e-6  # m: a smaller swing is none
_KEPT = 0.98  # of a swing after a quarter of the run: one that dies away any slower is not told from one that stays


def _stop(chance: random.Random, most: float = 0.03) -> Modules:
    """A stop at either side of the hand, so that a steady push comes to rest."""
    stop = {"type": "buffer", "stiffness": chance.uniform(300.0, 1500.0), "damping": chance.uniform(2.0, 6.0)}
    way = chance.uniform(0.012, most)
    ends = {"low": {"type": "ground", "position": -way}, "high": {"type": "ground", "position": way}}
    return ends | {"floor": stop | {"between": ["hand", "low"]}, "roof": stop | {"between": ["high", "hand"]}}


def _spring(chance: random.Random, first: str, second: str, least: float, most: float, damping: float = 2.0) -> Modules:
    stiffness = least * (most / least) ** chance.random()
    return {
        "type": "viscoelastic",
        "between": [first, second],
        "stiffness": stiffness,
        "damping": chance.uniform(0.05, damping),
    }


def _mass(chance: random.Random) -> float:
    return float(10.0 ** chance.uniform(-1.7, -0.5))


def _detent(chance: random.Random, first: str, second: str) -> Modules:
    return {
        "type": "detent",
        "between": [first, second],
        "pitch": chance.uniform(0.002, 0.01),
        "depth": chance.uniform(0.2, 3.0),
        "damping": chance.uniform(0.0, 1.0),
        "shape": (shape := chance.choice(("snap", "snap", "notch", "sine"))),
    } | ({} if shape == "sine" else {"sharpness": chance.uniform(1.0, 4.0)})


def _table(chance: random.Random, first: str, second: str) -> Modules:
    """A table of four to six points within 1 to 3 cm, anywhere within 2 cm."""
    count = chance.randint(4, 6)
    x = np.cumsum([chance.uniform(0.001, 0.006) for _ in range(count)])
    x = x - x.mean() + chance.uniform(-0.02, 0.02)
    points = [[float(at), chance.uniform(-2.0, 2.0)] for at in x]
    return {"type": "nonlinear", "between": [first, second], "force_over_distance": points}


def _behind(chance: random.Random) -> tuple[Modules, str]:
    """The part that the hand moves, on a spring, and its name: a mass or another hand."""
    if chance.random() < 0.2:
        return {"other": {"type": "device", "channel": 1}, "rod": _spring(chance, "hand", "other", 100, 3000)}, "other"
    return {"ball": {"type": "mass", "mass": _mass(chance)}, "rod": _spring(chance, "hand", "ball", 100, 3000)}, "ball"


def detents(chance: random.Random) -> Modules:
    """A detent of several periods beside another contact, on a hand that moves a mass or another hand, or that has
    several dampers."""
    modules = _stop(chance)
    if chance.random() < 0.3:
        other = "hand"
        modules["drag"] = _spring(chance, "hand", "wall", 20.0, 500.0, 4.0) | {"damper": "centred"}
    else:
        behind, other = _behind(chance)
        modules |= behind
    modules["detent"] = _detent(chance, *chance.choice((("hand", "wall"), (other, "wall"))))
    for n in range(chance.randint(1, 2)):
        at, where = chance.choice(("hand", other)), f"place{n}"
        modules[where] = {"type": "ground", "position": chance.uniform(-0.02, 0.02)}
        kind = chance.choice(("buffer", "table", "detent"))
        if kind == "buffer":
            modules[f"more{n}"] = {
                "type": "buffer",
                "between": chance.choice(([at, where], [where, at])),
                "stiffness": 10.0 ** chance.uniform(2.3, 3.8),
                "damping": chance.uniform(0.0, 5.0),
            }
        else:
            modules[f"more{n}"] = (_table if kind == "table" else _detent)(chance, at, where)
    return modules


def snaps(chance: random.Random) -> Modules:
    """A detent, or a table that falls somewhere, on a moving mass."""
    behind, other = _behind(chance)
    ends = chance.choice(((other, "wall"), (other, "wall"), ("hand", "wall")))
    snap = _detent(chance, *ends) | {"depth": chance.uniform(0.5, 5.0)}
    if chance.random() < 0.3:
        snap = _table(chance, *ends)
    return behind | {"snap": snap, "soft": _spring(chance, "hand", "wall", 10.0, 200.0, 1.0)}


def brakes(chance: random.Random) -> Modules:
    """A spring whose brake's force flattens, falls or steps over the speed, alike both ways or not."""

    def side() -> list[float]:
        slope, force, found, speed = chance.uniform(0.2, 8.0), 0.0, [], 0.0
        for _ in range(chance.randint(1, 3)):
            step = 10.0 ** chance.uniform(-2.0, 0.1)
            speed, force = speed + step, force + slope * step
            found += [speed, force]
            slope = chance.choice((0.0, 0.0, -0.3 * force / speed, chance.uniform(0.0, 4.0)))
        return found

    right = side()
    left = right if chance.random() < 0.7 else side()
    points = [[-left[i], -left[i + 1]] for i in range(0, len(left), 2)][::-1]
    points += [[right[i], right[i + 1]] for i in range(0, len(right), 2)]
    if chance.random() < 0.3:
        points = [*[one for one in points if one[0] < 0.0], [0.0, 0.0], *[one for one in points if one[0] > 0.0]]
    brake = {"type": "nonlinear", "between": ["hand", "wall"], "force_over_velocity": points}
    spring = _spring(chance, "hand", "wall", 100.0, 3000.0, 0.3) | {"damping": chance.choice((0.0, 0.0, 0.3))}
    if chance.random() < 0.3:
        behind, other = _behind(chance)
        return behind | {"brake": brake | {"between": [other, "wall"]}, "spring": spring}
    return {"brake": brake, "spring": spring}


def toggles(chance: random.Random) -> Modules:
    """A lever with a table that falls in its middle, or the hand itself, and the lever's spring."""
    half, wide = chance.uniform(0.001, 0.004), chance.uniform(0.002, 0.006)
    peak, end = chance.uniform(0.3, 3.0), chance.uniform(1.0, 5.0)
    off = chance.choice((0.0, 0.0, chance.uniform(-0.5, 0.5))) * half
    points = [[-half - wide, -end], [-half, peak], [half, -peak], [half + wide, end]]
    ends = chance.choice((["lever", "wall"], ["lever", "wall"], ["hand", "lever"]))
    hold = ["lever", "wall"] if ends[0] == "hand" else ["hand", "lever"]
    air = {"type": "damper", "between": [chance.choice(("lever", "hand")), "wall"], "damping": chance.uniform(0, 2)}
    return {
        "lever": {"type": "mass", "mass": _mass(chance)},
        "rod": _spring(chance, *hold, 300.0, 5000.0, 5.0),
        "toggle": {"type": "nonlinear", "between": ends, "force_over_distance": [[x + off, f] for x, f in points]},
        "air": air,
        "soft": _spring(chance, "hand", "wall", 5.0, 50.0, 0.5),
    }


def lines(chance: random.Random) -> Modules:
    """One to three laws that lines follow, on a hand that moves a mass or another hand, or nothing else."""
    modules, other = _behind(chance) if chance.random() < 0.6 else ({}, "hand")
    modules |= _stop(chance)
    for n in range(chance.randint(1, 3)):
        at, where = chance.choice(("hand", "hand", other)), f"place{n}"
        modules[where] = {"type": "ground", "position": chance.uniform(-0.01, 0.01)}
        kind = chance.choice(("spring", "buffer", "table", "detent", "saw"))
        if kind == "spring":
            law = _spring(chance, at, where, 20.0, 30_000.0, 5.0)
        elif kind == "buffer":
            law = {"type": "buffer", "between": chance.sample((at, where), 2), "damping": chance.uniform(0.0, 5.0)}
            law["stiffness"] = 10.0 ** chance.uniform(2.3, 4.5)
        else:
            law = (_table if kind == "table" else _detent)(chance, at, where)
            law |= {"shape": "snap", "sharpness": 20.0} if kind == "saw" else {}
        modules[f"law{n}"] = law
    return modules


def _board(chance: random.Random) -> dict[str, Any]:
    """The loop of a board that follows lines, of 4 to 30 kHz, behind a wire of 0 to 5 samples."""
    steps = chance.choice((4, 5, 10, 20, 30))
    loop = {"board_rate": 1000 * steps, "board_delay": chance.choice((0, 1, 1, 2))}
    own = {"board_window": chance.choice((1, steps, chance.randint(1, steps))), "stiffness": chance.choice((0, 0, 300))}
    return {"law": "board", "delay": chance.randint(0, 5 * steps) / steps} | loop | own


KINDS: dict[str, Callable[[random.Random], Modules]] = {
    "detents": detents,
    "snaps": snaps,
    "brakes": brakes,
    "toggles": toggles,
    "lines": lines,
}


def verdict_scene(kind: str, seed: int) -> dict[str, Any]:
    """Returns the document of a random scene of this kind."""
    chance = random.Random(f"{kind} {seed}")
    device: dict[str, Any] = {
        "clock": "lockstep",
        "force_limit": LIMIT,
        "mass": chance.uniform(0.05, 0.4),
        "friction": 10.0 ** chance.uniform(-0.7, 0.5),
        "delay": chance.choice((0, 1, 1, 2)),
    }
    modules: Modules = {"wall": {"type": "ground"}, "hand": {"type": "device", "channel": 0}}
    if kind == "lines":
        device |= _board(chance)
    return {"version": 1, "rate": 1000, "device": device, "modules": modules | KINDS[kind](chance)}


class Push(NamedTuple):
    """Knock of the first hand, m/s, and the force with which it then presses steadily, N."""

    speed: float
    force: float


def pushes(seed: int, count: int) -> Iterator[Push]:
    """Knocks of 0.1 to 1 m/s, knocks with a steady press of 0.1 to 1 of the force limit, and presses, in turn: the
    hardest first, then random ones."""
    chance = random.Random(seed)
    for n in range(count):
        speed, force = (1.0, 1.0) if n < 3 else (chance.uniform(0.1, 1.0), chance.uniform(0.1, 1.0))
        sides = chance.choice((-1.0, 1.0)), chance.choice((-1.0, 1.0))
        yield Push(sides[0] * speed * (n % 3 < 2), sides[1] * force * LIMIT * (n % 3 > 0))


def as_scene(document: dict[str, Any], push: Push | None = None) -> Scene:
    mock: dict[str, Any] = {"quantum": 1e-7}
    if push is not None:
        channels = sum(one["type"] == "device" for one in document["modules"].values())
        rest = [0.0] * (channels - 1)
        mock |= {"initial": {"velocity": [push.speed, *rest]}, "hand": {"force": [push.force, *rest]}}
    return parse_scene(yaml.safe_dump(document | {"mock": mock}, sort_keys=False), "random scene")


def is_shaken(document: dict[str, Any], push: Push) -> bool:
    """Returns whether a guard ends the run, or a hand swings on. What swings on after some seconds is run again for
    longer, to tell it from what dies away slowly."""
    return all(_swings_on(document, push, seconds) for seconds in (8, 40))


def _swings_on(document: dict[str, Any], push: Push, seconds: int) -> bool:
    """Returns whether a hand swings as far in a second of the last quarter as in each second of the second one."""
    try:
        trace = run_in_memory(as_scene(document, push), duration=seconds)
    except GuardError:
        return True
    if trace.report.ending != "done":
        return True
    x = trace.position.reshape(4 * (seconds // 4), -1, trace.position.shape[1])
    swing, quarter = np.ptp(x, axis=1), len(x) // 4
    late, early = swing[-quarter:], swing[quarter : 2 * quarter]
    travels = np.abs(x[-1, -1] - x[-quarter, 0]) > 0.5 * late.sum(axis=0)
    goes_on = (late.max(axis=0) > _LEAST) & (late.max(axis=0) > _KEPT * early.min(axis=0))
    return bool((goes_on & ~travels).any())
