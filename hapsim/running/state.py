"""What is going on in a running scene: its latest values, and what has happened."""

from __future__ import annotations

import html
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from hapsim.cordis.program import Program, positions_of
from hapsim.errors import UsageError
from hapsim.progress import Progress
from hapsim.running.assemble import LoopMemory
from hapsim.scene import Scene
from hapsim.scene.issue import did_you_mean

EventKind = Literal[
    "armed",
    "changed",
    "rejected",
    "marker",
    "recording",
    "recorded",
    "lost",
    "waiting",
    "reconnected",
    "guard",
    "ended",
]
_TRIES = 8


@dataclass(frozen=True)
class Event:
    """Something that happened to a run."""

    kind: EventKind
    sentence: str = ""
    values: Mapping[str, Any] = field(default_factory=dict)
    """Of `changed`: the parameters, by name."""
    sample: int = 0
    """The device's sample at which it was noticed, counted from arming."""
    at: str = field(default_factory=lambda: datetime.now(UTC).isoformat(timespec="milliseconds"))
    """UTC, ISO 8601."""


@dataclass(frozen=True)
class State:
    """The latest values of a running scene of C channels."""

    sample: int
    """The device's number of the newest position, counted from arming."""
    age_s: float
    """Since that position arrived."""
    position: tuple[float, ...]
    """(C,) m."""
    velocity: tuple[float, ...]
    """(C,) m/s: the difference of the last two positions over the time between them."""
    force: tuple[float, ...]
    """(C,) N, that was sent last: 0 once the run is over."""
    modules: Mapping[str, float | NDArray[np.float64]]
    """m: where each point is; of a string or a membrane (masses,) where each of its masses is. Taken while the loop
    runs: masses of one structure may differ by a sample."""
    progress: Progress
    """Phase, rate and counters."""


class StateReader:
    """Reads the latest values of a loop beside it. The loop does not notice."""

    def __init__(self, loop: LoopMemory, rate: float) -> None:
        self._loop, self._rate = loop, rate
        self._program: Program | None = None
        self._places: dict[str, int | NDArray[np.int64]] = {}

    def read(self, progress: Progress) -> State:
        """Returns the values now. `progress`: of the same moment."""
        io, state, used = self._loop.record.io, self._loop.state, slice(self._loop.wire.channels)
        for _ in range(_TRIES):  # until no sample came meanwhile
            sample, newest = int(state.sample), int(state.newest_ns)
            here, before, gap = io.measured[used].copy(), io.before[used].copy(), max(int(state.gap), 1)
            force = (io.force_counts * io.force_scale)[used]
            if sample == int(state.sample):
                break
        return State(
            sample=sample,
            age_s=max(time.monotonic_ns() - newest, 0) * 1e-9 if newest else 0.0,
            position=tuple(here.tolist()),
            velocity=tuple(((here - before) * self._rate / gap).tolist()),
            force=tuple(force.tolist()),
            modules=self.modules(),
            progress=progress,
        )

    def positions(self, names: Sequence[str]) -> tuple[int, NDArray[np.float64]]:
        """Returns the newest sample's number, and where points and masses of structures ("gut.7", "skin.3.4") are:
        (names,) m. Raises UsageError where there is no such one."""
        program, hands = self._loop.program, self._hands()
        row, numbers = positions_of(program)[0], program.numbers
        for name in names:
            if name not in numbers:
                part = name.partition(".")[0]
                masses = [one for one in numbers if one.startswith(f"{part}.")]
                near = f"one of its masses, {masses[0]} to {masses[-1]}" if masses else "a point, or a structure's mass"
                others = {one.partition(".")[0]: None for one in numbers}
                raise UsageError(f"found '{name}', expected {near}{'' if masses else did_you_mean(part, list(others))}")
        places = [hands[name] if name in hands else row[numbers[name]] for name in names]
        return int(self._loop.state.sample), np.array(places, np.float64)

    def modules(self) -> dict[str, float | NDArray[np.float64]]:
        """Returns where each point is."""
        program = self._loop.program
        if program is not self._program:
            self._program, self._places = program, _places(program.numbers)
        row = positions_of(program)[0]
        return {
            name: row[place].astype(np.float64) if isinstance(place, np.ndarray) else float(row[place])
            for name, place in self._places.items()
        } | self._hands()

    def _hands(self) -> dict[str, float]:
        """Where the hands were measured, in m: their places in the program are the tick's own."""
        measured = self._loop.record.io.measured
        return {name: float(measured[one.channel]) for name, one in self._loop.rendered_scene.device_points.items()}


def _places(numbers: Mapping[str, int]) -> dict[str, int | NDArray[np.int64]]:
    """Where each module stands in a program's rows: one number, or those of a structure's masses."""
    places: dict[str, Any] = {}
    for name, number in numbers.items():
        module, dot, _ = name.partition(".")
        if dot:
            places.setdefault(module, []).append(number)
        else:
            places[name] = number
    return {name: np.array(place) if isinstance(place, list) else place for name, place in places.items()}


def as_html(scene: Scene, name: str, state: State, parameters: Mapping[str, Any]) -> str:
    """Returns a session for a notebook: what runs where, each channel, each parameter."""
    progress = state.progress
    title = f"{scene.path or 'a scene'} on {name}: {progress.phase}, {progress.elapsed_s:.1f} s"
    rate = "" if progress.seen_rate_hz is None else f", {progress.seen_rate_hz:.1f} Hz"
    channels = "".join(
        f"<tr><td>channel {c}</td><td>{x:.6g} m</td><td>{v:.4g} m/s</td><td>{f:.4g} N</td></tr>"
        for c, (x, v, f) in enumerate(zip(state.position, state.velocity, state.force, strict=True))
    )
    values = "".join(
        f"<tr><td>{html.escape(one.name)}</td><td colspan=3>{html.escape(_short(one.value))} {one.unit}</td></tr>"
        for one in parameters.values()
    )
    misses = f", {progress.deadline_misses} deadline misses of {progress.ticks} ticks"
    return f"<table><caption>{html.escape(title + rate + misses)}</caption>{scene.units(channels)}{values}</table>"


def _short(value: Any) -> str:
    if isinstance(value, tuple):
        return f"[{', '.join(map(_short, value[:4]))}{', …' if len(value) > 4 else ''}]"
    return f"{value:g}" if isinstance(value, float) else str(value)
