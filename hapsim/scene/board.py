"""The force law on the board: its local loop between two samples of the host, and what a scene with it excludes."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple

from .choices import AHEAD
from .issue import Issue, Path, with_article
from .modules.links import ViscoElastic
from .modules.point_modules import DevicePoint
from .quantity import count, quantity
from .section import ModuleContext
from .written_units import QUANTITY, in_si

BOARD_RATE = quantity("Rate at which the board follows its law", "Hz", above=0)
BOARD_DELAY = count("Delay of the board's force behind its measurement, in local periods", 0, 1000)
BOARD_WINDOW = count(
    "Local periods over which the board measures the velocity", 1, 10_000, left_out="one sample of the host"
)

_WHOLE = 1e-9  # relative: rates whose ratio is off by less are whole multiples
_DEFAULTS: dict[str, Any] = {"board_rate": 10_000.0, "board_delay": 1, "board_window": None}
_ALONE = {
    "hold": ("zoh", "the board holds each force for a local period"),
    "sampling": ("ideal", "the board measures at an instant"),
    "decimation": ("last", "a line answers one sample"),
}


class Board(NamedTuple):
    """The board's loop: ``steps`` local periods in a sample of the host; ``delay`` of the force behind its measurement,
    and ``window`` of the velocity, both in local periods."""

    steps: int
    delay: int
    window: int


def board_of(rate: float, board_rate: float, delay: int, window: int | None) -> Board:
    """Returns the board's loop beside a host of ``rate`` Hz."""
    steps = max(1, round(board_rate / rate))
    return Board(steps, delay, steps if window is None else window)


def board_issues(
    around: ModuleContext, parts: Mapping[Path, Mapping[str, Any]], scene: Mapping[str, object]
) -> Iterator[Issue]:
    """Yields what does not fit the place of the force law. ``parts``: the sound fields of device and mock."""
    device = parts[("device",)]
    if device.get("law", "host") != "board":
        for key, default in _DEFAULTS.items():
            if device.get(key, default) != default:
                sentence = f"found {with_article(key)} without its law; add device.law: board, or omit {key}"
                yield Issue(("device", key), sentence, at_key=True)
        return
    yield from _loop_issues(parts, scene.get("rate"))
    for name in ("device", "mock"):
        for key, (right, why) in _ALONE.items():
            if (found := parts[(name,)].get(key)) not in (None, right):
                yield Issue((name, key), f"found {found} with law: board, expected {right}: {why}")
        for key, words in _of_many(parts, name).items():
            sentence = f"found a {words} with law: board, expected one mass that the force moves at once"
            yield Issue((name, key), sentence, at_key=True)
    if (correction := device.get("correction")) in AHEAD:
        sentence = f"found {correction} with law: board, whose force answers the board's own reading"
        yield Issue(("device", "correction"), f"{sentence}; expected none or poles")
    if scene.get("space", 1) != 1:
        yield Issue(("device", "law"), "found board with space: 2, expected host: a line has one coordinate")
    for name, link in around.of_type(ViscoElastic, "damper", "between").items():
        if link.damper != "backward" and any(around.kinds.get(end) is DevicePoint for end in link.between):
            sentence = f"found {link.damper} at a hand with law: board, which measures the velocity over its window"
            yield Issue(("modules", name, "damper"), f"{sentence}; expected backward")


def _loop_issues(parts: Mapping[Path, Mapping[str, Any]], rate: object) -> Iterator[Issue]:
    """Yields a rate, a window and delays that have no whole number of local periods in a sample."""
    device = parts[("device",)]
    if device.get("clock") == "host":
        sentence = "found host with law: board, expected device or lockstep: a timer of the board paces it"
        yield Issue(("device", "clock"), sentence)
    board_rate, own = _hertz(device.get("board_rate", _DEFAULTS["board_rate"])), _hertz(rate)
    if board_rate is None or own is None:
        return
    steps = round(board_rate / own)
    if steps < 1 or abs(board_rate / own - steps) > _WHOLE * steps:
        sentence = f"found ‹{board_rate!r} Hz›, expected a whole multiple of the rate, ‹{own!r} Hz›"
        yield Issue(("device", "board_rate"), sentence)
        return
    if isinstance(window := device.get("board_window"), int) and window > steps:
        sentence = f"found {window}, longer than a sample; expected at most {steps} local periods"
        yield Issue(("device", "board_window"), sentence)
    for name in ("device", "mock"):
        delay = parts[(name,)].get("delay")
        if isinstance(delay, int | float) and abs(delay * steps - (whole := round(delay * steps))) > _WHOLE * steps:
            sentence = f"found {delay:g} samples with law: board, expected a whole number of local periods"
            why = f"such as {whole / steps:g}: a line begins with one, 1/{steps} of a sample"
            yield Issue((name, "delay"), f"{sentence}, {why}")


def _of_many(parts: Mapping[Path, Mapping[str, Any]], name: str) -> dict[str, str]:
    """Returns the keys by which more than one mass moves, or not at once, each in words."""
    stated = parts[(name,)]
    lag, mass = stated.get("motor_lag"), stated.get("mass")
    found = {
        "transmission": stated.get("transmission") is not None or bool(parts[(name, "transmission")]),
        "motor lag": any(lag) if isinstance(lag, list | tuple) else lag not in (None, 0, 0.0),
        "matrix": isinstance(mass, list | tuple) and any(isinstance(row, list | tuple) for row in mass),
    }
    keys = {"motor lag": "motor_lag", "matrix": "mass"}
    return {keys.get(words, words): words for words, is_so in found.items() if is_so}


def _hertz(value: object) -> float | None:
    """Returns a rate, made or as written, in Hz; None for anything else."""
    if isinstance(value, str) and QUANTITY.match(value):
        value = in_si(value, "Hz")
    return float(value) if isinstance(value, int | float) and not isinstance(value, bool) and value > 0 else None
