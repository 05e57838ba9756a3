"""A device that follows lines, written out: its mass moved exactly between local steps, without counts; and the hook
that finds lines, alone."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from typing import Any

import numpy as np

from firmware_protocol.compiled import new_record
from hapsim.compiling.native import address_of
from hapsim.cordis import offline
from hapsim.cordis.program import compile_scene
from hapsim.cordis.substep_loop import SCENE_SLOT
from hapsim.loop.board_law import BOARD_LAW, find_lines
from hapsim.loop.buffers import IO_BUFFER
from hapsim.loop.hooks import TICK
from hapsim.scene import Scene

RATE, MASS, LIMIT, FASTEST, STEPS = 1000.0, 0.2, 10.0, 2.0, 10
Line = tuple[float, float, float, float, float]


def scene_with(links: dict[str, dict[str, Any]], **more: Any) -> Scene:
    """A hand with these links; each joins hand and wall if it does not say otherwise."""
    modules: dict[str, Any] = {"hand": {"type": "device", "channel": 0}, "wall": {"type": "ground"}}
    modules |= more.pop("modules", {})
    modules |= {name: {"between": ["hand", "wall"]} | link for name, link in links.items()}
    device = {"law": "board", "mass": MASS, "force_limit": LIMIT, "clock": "lockstep"} | more.pop("device", {})
    document = {"version": 1, "rate": RATE, "device": device, "modules": modules} | more
    return Scene.model_validate(document)


class Rig:
    """The hook that finds lines, on a scene with one hand."""

    def __init__(self, scene: Scene, delay: float = 1.0, limit: float = LIMIT) -> None:
        self.program = compile_scene(scene)
        self.io, self.slot, self.tick, self.own = map(new_record, (IO_BUFFER, SCENE_SLOT, TICK, BOARD_LAW))
        self.io.channels, self.tick.io, self.tick.gap = scene.channels, address_of(self.io), 1
        self.slot.program, self.slot.substeps = self.program.address, 1
        own, until = self.own, delay + 2.0
        own.slot, own.rate, own.step_rate = address_of(self.slot), RATE, RATE
        own.lead, own.until, own.law.fastest_way = delay + 1.0 / STEPS, until, FASTEST / RATE
        own.reach[:] = 0.5 * limit / MASS * (until / RATE) ** 2
        self._still, self._force = np.zeros((2, self.io.measured.size))
        offline.start(self.program, self._still)

    def start(self, x: float) -> None:
        """Begins with the hand at rest at x m."""
        self._still[0] = x
        offline.start(self.program, self._still)
        self._still[0] = 0.0

    def host_force(self) -> Line:
        """Returns the force that the host's law gave at the last place, as a line without stiffness."""
        force = float(self._force[0])
        return force, 0.0, 0.0, force, force

    def line(self, x: float, v: float) -> Line:
        """Moves the scene by a sample, and returns F, k, b, low and high of the hand at x m and v m/s."""
        self.io.measured[0], self.io.before[0] = x, x - v / RATE
        offline.tick(self.program, self.io.measured, self._still, self._force)
        find_lines(address_of(self.own), address_of(self.tick))
        io = self.io
        return tuple(float(one[0]) for one in (io.asked, io.stiffness, io.damping, io.low, io.high))  # type: ignore[return-value]


def force_of(line: Line, ahead: float, speed: float) -> float:
    """Force of a line, N, at a place `ahead` m of that which it answers."""
    force, k, b, low, high = line
    u = force - k * ahead
    return low if u <= low else high if u >= high else min(max(u - b * speed, low), high)


class BoardDevice:
    """A mass of MASS kg with viscous friction and lines, STEPS local steps in a sample, a local delay of one step.
    `follows`: its force by a line, the way from there and the speed; `later`: it takes that way from the position so
    many samples behind the one that the line answers, at most from where the line begins. `reads`: its reading, m."""

    def __init__(
        self,
        x: float,
        v: float,
        *,
        friction: float = 0.0,
        delay: int = 1,
        window: int = STEPS,
        follows: Callable[[Line, float, float], float] = force_of,
        later: int = 0,
        reads: Callable[[float], float] = float,
    ) -> None:
        self.x, self.v, self.work = x, v, 0.0
        h = 1.0 / (RATE * STEPS)
        if friction:
            decay = math.exp(-friction / MASS * h)
            glide = (1.0 - decay) * MASS / friction
            self._step = glide, decay, (h - glide) / friction, (1.0 - decay) / friction
        else:
            self._step = h, 1.0, 0.5 * h * h / MASS, h / MASS
        self._follows, self._reads, self._later = follows, reads, later
        rest: Line = (0.0, 0.0, 0.0, 0.0, 0.0)
        self._reports = [x]
        self._lines = deque([(rest, 0)] * (delay + 1), delay + 1)
        self._past = deque([x - v * h * (i + 1) for i in range(window)], window)
        self._window, self._force = window * h, 0.0

    def sample(self, answer: Callable[[float], Line], *, late: bool = False) -> float:
        """Lets the host answer the reading, and moves on by a sample; a late answer never acts. Returns the reading."""
        read = reported = self._reads(self.x)
        answered = answer(reported), len(self._reports)
        self._lines.append(self._lines[-1] if late else answered)
        self._reports.append(reported)
        line, number = self._lines[0]
        at = self._reports[min(max(number + self._later, 0), len(self._reports) - 1)]
        glide, decay, pushed, sped = self._step
        for step in range(STEPS):
            read = self._reads(self.x) if step else reported
            speed = (read - self._past[-1]) / self._window
            acts, self._force = self._force, self._follows(line, read - at, speed)
            self._past.appendleft(read)
            before = self.x
            self.x, self.v = self.x + glide * self.v + pushed * acts, decay * self.v + sped * acts
            self.work += acts * (self.x - before)
        return reported


def host_line(law: Callable[[float], float]) -> Callable[[float], Line]:
    """The host's law: a force that is held."""

    def answer(x: float) -> Line:
        force = float(law(x))
        return force, 0.0, 0.0, force, force

    return answer


def board_line(rig: Rig, law: str = "board") -> Callable[[float], Line]:
    """The lines of a rig, whose hand is where it is sampled; or by its law, "host", the forces."""
    before: list[float] = []

    def answer(x: float) -> Line:
        v = (x - before[0]) * RATE if before else 0.0
        before[:] = [x]
        line = rig.line(x, v)
        return line if law == "board" else rig.host_force()

    return answer
