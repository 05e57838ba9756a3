"""A running scene that is served, and clients of it."""

from __future__ import annotations

import contextlib
import json
import struct
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import jsonschema
import numpy as np
import pytest
from numpy.typing import NDArray
from websockets.sync.client import ClientConnection, connect

from hapsim.live.access import Address, address_of
from hapsim.live.hub import Hub
from hapsim.live.server import Server
from hapsim.live.web import WebView
from hapsim.running import Session, start
from hapsim.scene import Scene, parse_scene

SCENE = """
version: 1
rate: 1000
device: {clock: host, mass: 0.2, friction: 1.0, force_limit: 10}
mock: {initial: {position: 0.0, velocity: 0.1}}
modules:
  hand: {type: device, channel: 0}
  wall: {type: ground, position: 0.0}
  touch: {type: viscoelastic, between: [hand, wall], stiffness: 2000, damping: 5}
"""
SCHEMA = json.loads((Path(__file__).parents[2] / "hapsim/live/messages.json").read_text("utf-8"))
REQUESTS, ANSWERS = (
    jsonschema.Draft202012Validator({"$ref": f"#/$defs/{name}", "$defs": SCHEMA["$defs"]})
    for name in ("requests", "answers")
)


@dataclass(frozen=True)
class Block:
    kind: int
    first: int
    period: float
    channels: int
    rows: NDArray[np.float32]


def block(data: bytes) -> Block:
    kind, rows, columns, channels, first, period = struct.unpack_from("<IIIIdd", data)
    return Block(kind, int(first), period, channels, np.frombuffer(data, "<f4", offset=32).reshape(rows, columns))


class Client:
    """A client that holds every message, in both directions, to the schema."""

    def __init__(self, socket: ClientConnection) -> None:
        self.socket = socket
        self.heard: list[dict[str, Any]] = []

    def send(self, **message: Any) -> None:
        REQUESTS.validate(message)
        self.socket.send(json.dumps(message))

    def next(self) -> dict[str, Any] | Block:
        data = self.socket.recv(timeout=30)
        if isinstance(data, bytes):
            return block(data)
        message: dict[str, Any] = json.loads(data)
        ANSWERS.validate(message)
        self.heard.append(message)
        return message

    def message(self, **fields: Any) -> dict[str, Any]:
        """The next message with these fields."""
        while True:
            found = self.next()
            if isinstance(found, dict) and all(found.get(key) == value for key, value in fields.items()):
                return found

    def ask(self, **message: Any) -> dict[str, Any]:
        self.send(**message, id=len(self.heard))
        while True:
            found = self.next()
            if isinstance(found, dict) and found["type"] not in ("event", "counters"):
                assert found["id"] == len(self.heard) - 1 or "id" in message
                return found

    def block(self, kind: int = 1) -> Block:
        while True:
            found = self.next()
            if isinstance(found, Block) and found.kind == kind:
                return found


@dataclass
class Served:
    hub: Hub
    session: Session
    view: WebView
    warnings: list[str]

    @property
    def origin(self) -> str:
        return f"http://127.0.0.1:{self.view.address.port}"

    @contextlib.contextmanager
    def client(self, **options: Any) -> Iterator[Client]:
        url = f"ws://127.0.0.1:{self.view.address.port}/live"
        with connect(url, **{"origin": self.origin, "compression": None, **options}) as socket:
            yield Client(socket)


@pytest.fixture
def serve(tmp_path: Path) -> Iterator[Callable[..., Served]]:
    """Runs a scene on the mock and serves it; ends both with the test."""
    with contextlib.ExitStack() as stack:

        def serving(scene: str | Scene = SCENE, address: Address | None = None, **options: Any) -> Served:
            scene = parse_scene(scene) if isinstance(scene, str) else scene
            hub, warnings = Hub(scene, tmp_path), []
            view = WebView(hub, address or address_of("--serve-at", ":0", 0), warnings.append)
            server = Server([view])
            server.start()
            stack.callback(server.close)
            session = stack.enter_context(start(scene, keep=False, **hub.options, **options))
            hub.observer.started(session)
            stack.callback(hub.observer.over)
            return Served(hub, session, view, warnings)

        yield serving
