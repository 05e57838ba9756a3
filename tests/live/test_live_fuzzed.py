"""Messages that nobody would send, by the thousand: each is answered, and the scene goes on within its limits."""

from __future__ import annotations

import copy
import json
import random
import socket
import threading
from collections.abc import Callable, Iterator
from typing import Any

import pytest
from live_clients import ANSWERS, SCENE, Served
from websockets.exceptions import ConnectionClosed

from hapsim.live import web
from hapsim.live.messages import Set, request_of
from tests import thorough

MESSAGES = thorough.points(200, 500)  # HAPSIM_POINTS=100000 sends a hundred thousand, in minutes
BATCH = 20  # sent before the first answer is read: no more than wait unread at the server
# Slow enough for a busy machine: the watchdog of 20 samples lasts 0.4 s.
SLOW = SCENE.replace("rate: 1000", "rate: 50").replace("stiffness: 2000, damping: 5", "stiffness: 2, damping: 0.5")

CLOSE = b"\x88"  # first byte of a frame

VALID: list[dict[str, Any]] = [
    {"type": "get", "id": 1},
    {"type": "set", "values": {"touch.stiffness": 1.5, "touch.damping": 0.2}, "over": 0.01, "id": "a"},
    {"type": "set", "values": {"touch.stiffness": 1.8}, "id": 0.5},
    {"type": "subscribe", "rate": 50, "every": 3, "history": 2, "modules": ["hand", "wall"]},
    {"type": "marker", "text": "here"},
    {"type": "pulse", "channel": 0, "shape": "click", "force": 0.5, "seconds": 0.05},
    {"type": "record", "on": False},
    {"type": "adopt", "scene": SLOW, "over": 0.01},
    {"type": "trial", "number": 3, "values": {"touch.stiffness": 1.2}, "restart": ["touch"], "code": None, "over": 0.0},
    {"type": "predict", "values": {"touch.stiffness": 9.0}, "hand": 0, "plane": False},
]
ODD = [
    None,
    True,
    -1,
    0,
    1e308,
    -1e308,
    2**70,
    "",
    "\0",
    "touch.stiffness",
    "ü" * 99,
    [],
    [[]],
    [1, "a"],
    {},
    {"a": {}},
]
WORDS = [
    "NaN",
    "-Infinity",
    "1e999",
    "null",
    "{",
    "}",
    "[" * 200,
    '"',
    "\\ud800",
    "\\u0000",
    ",",
    ":",
    "stiffness",
    "9" * 400,
]


def messages(seed: int) -> Iterator[str | bytes]:
    """Valid messages with a value, a key or some characters that are not."""
    choose = random.Random(seed)
    while True:
        message = json.loads(json.dumps(choose.choice(VALID if choose.random() > 0.02 else VALID[-2:-1])))
        for _ in range(choose.randrange(3)):
            part: Any = message
            while choose.random() < 0.5 and (inner := [one for one in part.values() if isinstance(one, dict) and one]):
                part = choose.choice(inner)
            key = choose.choice([*part, choose.choice(["", "tpye", "values", "\n"])])
            part[key] = copy.deepcopy(choose.choice(ODD))
        text = json.dumps(message)
        for _ in range(choose.choice((0, 0, 1, 5))):
            at, to = sorted(choose.choices(range(len(text) + 1), k=2))
            text = text[:at] + choose.choice(["", *WORDS]) + text[choose.choice((at, at, to)) :]
        if '"stop"' not in text:
            yield text.encode() if choose.random() < 0.02 else text


def test_every_message_is_answered_and_the_scene_goes_on(
    serve: Callable[..., Served], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(web, "MESSAGES_PER_S", 1e9)
    served, fuzz, kinds = serve(SLOW), messages(35), set()
    with served.client() as client:
        for _ in range(MESSAGES // BATCH):
            assert served.hub.phase == "running", served.hub.events[-1].sentence
            for _ in range(BATCH):
                client.socket.send(next(fuzz))
            left = BATCH
            while left:
                data = client.socket.recv(timeout=60)
                found = json.loads(data) if isinstance(data, str) else {}
                if found.get("type") not in (None, "event", "counters"):
                    left -= 1
                    kinds.add(found["type"])
                    assert ANSWERS.is_valid(found), found
                    assert "defect" not in found.get("reason", ""), found
        client.ask(type="subscribe", rate=0)
        state = served.session.state()
        assert client.ask(type="get")["phase"] == "running"
    assert kinds >= {"done", "rejected", "model"}
    while served.session.state().sample == state.sample:  # it goes on; a run that had ended stays where it is
        assert served.session.progress().phase == "running"
    assert max(map(abs, state.force)) <= 10.0
    assert threading.active_count() < 30
    assert not served.warnings


def test_bytes_that_are_no_frames_close_the_connection_and_nothing_else(shared: Served) -> None:
    choose = random.Random(7)
    for _ in range(50):
        with shared.raw() as connection:
            connection.sendall(choose.randbytes(choose.randrange(1, 200)) + b"\xff" * 8)
            connection.shutdown(socket.SHUT_WR)  # they may begin a frame that never ends
            answer = b"".join(iter(lambda: connection.recv(4096), b""))
            assert not answer or answer[:1] == CLOSE
    with shared.client() as client:
        client.socket.send(b"\xff\xfe", text=True)  # no UTF-8
        with pytest.raises(ConnectionClosed):
            client.next()
        assert client.closed[0] == 1007
    with shared.client() as client:
        assert client.ask(type="get")["phase"] == "running"
    assert not shared.warnings


def test_a_curve_with_two_branches_is_a_value() -> None:
    branches = {"press": [[0.0, 0.0], [0.01, 1.0]], "release": [[0.0, 0.0], [0.01, 0.5]], "turn": 0.001}
    values = {"button.force_over_distance": branches}
    request = request_of(json.dumps({"type": "set", "values": values}))
    assert isinstance(request, Set)
    assert request.values == values
