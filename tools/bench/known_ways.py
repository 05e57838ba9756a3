"""The known ways to stiff springs side by side, on one hand: largest stable K, felt k and b, stiffness for any hand.

Prints the rows of the table in hapsim/STABILITY.md. The theory alone is used. B is 5 N·s/m beside 1 N·s/m of the
device: 6 are asked for. The largest K is that of the scene up to which it is stable, in steps of a quarter and then
halved; with a correction it is also felt as asked. For any hand: the stiffest spring of a wall, with the best damper,
that no passive hand makes unstable.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

from hapsim.prediction import Felt, predict, z_width_of
from hapsim.scene import Scene, parse_scene

SCENE = """
version: 1
rate: 1000
device: {{mass: 0.2, friction: {friction}, delay: {delay}{device}}}
modules:
  hand: {{type: device, channel: 0}}
  wall: {{type: ground}}
  touch: {{type: viscoelastic, between: [hand, wall], stiffness: {K!r}, damping: {B!r}{link}}}
"""
SOFTEST, STIFFEST, STEP, DIGITS = 300.0, 4e5, 1.25, 1e-3
ADAPTIVE = "mass: {from: 0.1, to: 0.4}"
SENSED = ", sensors: [velocity, acceleration], correction: sensed"
WAYS: dict[str, tuple[dict[str, Any], str]] = {
    "host's law": ({}, "nothing"),
    "friction: 6 N·s/m in the device": ({"friction": 6.0, "B": 0.0}, "nothing; the hand feels it everywhere"),
    "`damper: sensed`": ({"link": ", damper: sensed"}, "velocity"),
    "`correction: poles`": ({"device": ", correction: poles"}, "mass, delay"),
    "`correction: predictor`": ({"device": ", correction: predictor"}, "mass, delay"),
    "`correction: adaptive`, 0.1 to 0.4 kg": ({"device": ", correction: adaptive"}, "range of the mass, delay"),
    "`correction: sensed`": ({"device": SENSED}, "velocity, acceleration, delay"),
    "`law: board`, 10 kHz": ({"device": ", law: board"}, "nothing; firmware that follows lines"),
    "`law: board`, 10 kHz, `board_window: 1`": ({"device": ", law: board, board_window: 1"}, "the same, fine counts"),
}


def scene_of(K: float, delay: int, friction: float = 1.0, B: float = 5.0, device: str = "", link: str = "") -> Scene:
    """Returns the scene of a way."""
    text = SCENE.format(K=K, B=B, friction=friction, delay=delay, device=device, link=link)
    return parse_scene(text.replace("mass: 0.2", ADAPTIVE) if "adaptive" in device else text)


def largest(is_good: Callable[[float], bool]) -> float:
    """Returns the stiffness at the end of the first range in which every step is good, N/m."""
    low = SOFTEST
    while low < STIFFEST and is_good(STEP * low):
        low *= STEP
    if low >= STIFFEST:
        return math.inf
    high = STEP * low
    while high / low > 1.0 + DIGITS:
        middle = math.sqrt(low * high)
        low, high = (middle, high) if is_good(middle) else (low, middle)
    return low


def felt_at(K: float, delay: int, way: dict[str, Any]) -> Felt:
    """Returns what the hand feels."""
    return predict(scene_of(K, delay, **way), with_margins=False).felt[0]


def row(name: str, way: dict[str, Any], needs: str) -> str:
    """Returns the row of a way, at one and at three samples of delay."""
    cells = []
    for delay in (1, 3):

        def good(K: float, delay: int = delay) -> bool:
            prediction = predict(scene_of(K, delay, **way), with_margins=False)
            return prediction.stable and all(one.reached for one in prediction.desired)

        most, felt = largest(good), felt_at(2000.0, delay, way)
        stable = felt.stable and felt.dominant
        pair = f"{felt.k:.0f}, {felt.b:.2f}" if stable else "unstable"
        cells += [f"{most:.4g}" if math.isfinite(most) else "any", pair]
    any_hand = "not derived"
    if not {"sensed", "predictor", "adaptive"} & {*f"{way.get('device')} {way.get('link')}".replace(",", " ").split()}:
        any_hand = f"{z_width_of(scene_of(2000.0, 1, **way), 0, [10.0])['passive'].wall.stiffness:.0f}"
    return f"| {name} | {' | '.join(cells)} | {any_hand} | {needs} |"


def main() -> None:
    """Prints the table."""
    print("| way | largest K, N/m, d = 1 | felt k, b | largest K, d = 3 | felt k, b | any hand, N/m | has to know |")
    print("|---|---|---|---|---|---|---|")
    for name, (way, needs) in WAYS.items():
        print(row(name, way, needs), flush=True)


main()
