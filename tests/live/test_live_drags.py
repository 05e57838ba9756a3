"""Random drags of sliders and of the mock's hand through the WebSocket, on passive scenes: no run ends, and no force is
above its limit."""

from __future__ import annotations

import random
from collections.abc import Callable

import numpy as np
import pytest
from live_clients import Client, Served

from tests import thorough

DRAGS = thorough.points(80, 160)  # in all: HAPSIM_POINTS=10000 in half a minute
TOGETHER = 20
LIMIT = 4.0
HAND = "device: {clock: lockstep, mass: 0.2, friction: 2.0, force_limit: 4}\nmock: {initial: {velocity: 0.1}}\n"
SPANS = {
    "touch.stiffness": (1.0, 600.0),  # a friction of 2 N·s/m is passive up to 1000 N/m with the damping
    "touch.damping": (0.0, 0.3),
    "stop.stiffness": (1.0, 300.0),
    "wall.position": (-0.01, 0.01),
    "pick.stiffness": (1.0, 100.0),
    "pick.release": (0.001, 0.01),
    "mock.hand.stiffness": (0.0, 500.0),
    "mock.hand.damping": (0.0, 5.0),
    "mock.hand.position": (-0.03, 0.03),
    "mock.hand.force": (-3.0, 3.0),
}
CONTACT = """
  touch: {type: viscoelastic, between: [hand, wall], stiffness: 300, damping: 0.2}
  stop: {type: buffer, between: [hand, wall], stiffness: 200, damping: 0.2, distance: 0.005}
"""
STRING = """
  gut: {type: string, masses: 12, mass: 0.01, stiffness: 300, damping: 0.02, friction: 0.01}
  touch: {type: viscoelastic, between: [hand, wall], stiffness: 100, damping: 0.1}
  pick: {type: plectrum, between: [hand, gut.4], stiffness: 50, damping: 0.02, release: 0.003}
"""


def drag(client: Client, names: list[str], chance: random.Random) -> None:
    """Some changes without a wait between them, as a hand at a slider sends; all are made."""
    for id in range(TOGETHER):
        name = chance.choice(names)
        value = chance.uniform(*SPANS[name])
        client.send(type="set", id=id, values={name: value}, over=chance.choice((0.0, 0.005, 0.02)))
    for id in range(TOGETHER):
        answer = client.message(id=id)
        assert answer["type"] == "done", answer


@pytest.mark.parametrize("modules", [CONTACT, STRING], ids=["contact", "string"])
def test_no_drag_stops_a_run_or_exceeds_a_limit(serve: Callable[..., Served], modules: str) -> None:
    chance, scene = random.Random(35), f"version: 1\nrate: 1000\n{HAND}modules:\n  hand: {{type: device, channel: 0}}"
    served = serve(f"{scene}\n  wall: {{type: ground}}{modules}", judges_sign=True)
    names, most = [name for name in served.session.parameters if name in SPANS], 0.0
    assert len(names) >= 8
    with served.client() as client:
        for _ in range(DRAGS // TOGETHER // 2):
            drag(client, names, chance)
            most = max(most, float(np.abs(served.session.history().force).max()))
    assert not served.session.wait(0.0)
    assert 0.5 < most <= LIMIT * (1.0 + 1e-9)
    served.session.close()
    assert served.session.trace.report.ending == "stopped"
    assert served.session.trace.report.parameter_changes > 0
