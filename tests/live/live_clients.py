"""A running scene that is served, and clients that hold every message to the schema."""

from __future__ import annotations

import contextlib
import json
import socket
import struct
import threading
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import jsonschema
import numpy as np
import pytest
from numpy.typing import NDArray
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import ClientConnection, connect

from hapsim.errors import RunError
from hapsim.live.access import address_of
from hapsim.live.hub import Hub
from hapsim.live.server import Server
from hapsim.live.web import WebView
from hapsim.loop import guards
from hapsim.loop.guards import frozen_sensor, leap
from hapsim.prediction import timing
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
SOFT = SCENE.replace("stiffness: 2000, damping: 5", "stiffness: 20, damping: 5")
"""Comes to rest, and shakes nobody, even where a busy machine answers positions tens of milliseconds late."""
CELL = """
version: 1
rate: 1000
device: {mass: 0.2, friction: 1.0}
modules:
  hand: {type: device, channel: 0}
  ball: {type: cell, mass: 0.05, stiffness: 2000, damping: 1.0}
  finger: {type: buffer, between: [hand, ball], stiffness: 500, damping: 1.0}
"""
DETENT = SCENE.replace(
    "touch: {type: viscoelastic, between: [hand, wall], stiffness: 2000, damping: 5}",
    "notch: {type: detent, between: [hand, wall], shape: snap, pitch: 0.01, depth: 1.0, sharpness: 1.0, damping: 5}",
)
PLANE = """
version: 1
rate: 1000
space: 2
device: {mass: 0.2, friction: 1.0}
modules:
  hand: {type: device, channels: [0, 1]}
  post: {type: ground, position: [0.03, 0.0]}
  ball: {type: mass, mass: 0.05, position: [0.0, 0.03]}
  disc: {type: shape, between: [hand, post], form: {disc: 0.02}, stiffness: 2000, damping: 5}
  ring: {type: shape, between: [ball, post], form: {box: [0.1, 0.08]}, side: inside, stiffness: 200}
"""
PATIENCE_S = 20.0
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
        self._asked = 0

    @property
    def closed(self) -> tuple[int | None, str | None]:
        return self.socket.close_code, self.socket.close_reason

    def send(self, **message: Any) -> None:
        REQUESTS.validate(message)
        self.socket.send(json.dumps(message))

    def next(self, timeout: float = 30.0) -> dict[str, Any] | Block:
        data = self.socket.recv(timeout=timeout)
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

    def event(self, kind: str, **values: Any) -> dict[str, Any]:
        """The first event of this kind with these values, which may have come before an answer."""

        def fits(message: dict[str, Any]) -> bool:
            is_of_kind = (message.get("type"), message.get("kind")) == ("event", kind)
            return is_of_kind and all(message["values"].get(key) == value for key, value in values.items())

        while not (found := [*filter(fits, self.heard)]):
            self.next()
        return found[0]

    def ask(self, **message: Any) -> dict[str, Any]:
        self._asked += 1
        self.send(**message, id=self._asked)
        return self.message(id=self._asked)

    def blocks_to_the_end(self) -> list[Block]:
        found = []
        with contextlib.suppress(ConnectionClosed):
            while True:
                one = self.next()
                found += [one] if isinstance(one, Block) and one.kind == 1 else []
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
    starting: Callable[[Scene], Session]
    is_paused: bool = False
    is_over: threading.Event = field(default_factory=threading.Event)

    @property
    def origin(self) -> str:
        return f"http://127.0.0.1:{self.view.address.port}"

    @contextlib.contextmanager
    def client(self, **options: Any) -> Iterator[Client]:
        url = f"ws://127.0.0.1:{self.view.address.port}/live"
        with connect(url, **{"origin": self.origin, "compression": None, **options}) as socket:
            yield Client(socket)

    @contextlib.contextmanager
    def raw(self, receive_buffer: int = 0) -> Iterator[socket.socket]:
        """A WebSocket that no library reads, answers or closes: the socket is the test's alone."""
        with socket.socket() as raw:
            if receive_buffer:
                raw.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, receive_buffer)
            raw.settimeout(60)
            raw.connect(("127.0.0.1", self.view.address.port))
            words = f"GET /live HTTP/1.1|Host: 127.0.0.1:{self.view.address.port}|Origin: {self.origin}|"
            words += "Upgrade: websocket|Connection: Upgrade|Sec-WebSocket-Version: 13|"
            words += "Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==||"
            raw.sendall(words.replace("|", "\r\n").encode())
            head = b""
            while not head.endswith(b"\r\n\r\n"):
                head += (byte := raw.recv(1))
                assert byte, head
            assert head.startswith(b"HTTP/1.1 101"), head
            yield raw

    @contextlib.contextmanager
    def ending(self) -> Iterator[None]:
        """Waits for the end of the run, which the with-block demands."""
        ended = threading.Event()
        self.hub.listen(lambda event: ended.set() if event.kind == "ended" else None)
        yield
        assert ended.wait(60)
        assert self.session.wait(60)
        assert self.hub.phase == "ended"

    def pause(self) -> None:
        """Pauses like a run that waits for its device."""
        self.is_paused = True
        self.session.stop()
        self.session.wait()
        self.hub.observer.over()

    def resume(self) -> None:
        self.session = self.starting(self.hub.scene)
        self.hub.observer.started(self.session)
        self.is_paused = False


@contextlib.contextmanager
def serving(
    scene: str | Scene = SCENE, address: str = ":0", record_dir: Path | None = None, **options: Any
) -> Iterator[Served]:
    """Runs a scene on the mock and serves it, as `hapsim run --serve` does."""
    scene = parse_scene(scene) if isinstance(scene, str) else scene
    warnings: list[str] = []
    hub = Hub(scene, record_dir)
    view = WebView(hub, address_of("--serve-at", address, 0), warnings.append)
    server = Server([view], warnings.append)
    server.start()

    def starting(scene: Scene) -> Session:
        """Host and mock wait for each other: a machine that is busy with other tests holds one of their threads up for
        longer than a tenth of a second, or two seconds. Meanwhile the mock's hand stands still, and then it moves as
        far as a leap or a stair."""
        false_alarms = leap.GUARD, frozen_sensor.GUARD
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(timing, "_WATCHDOG_S", PATIENCE_S)
            patch.setattr(guards, "GUARDS", tuple(one for one in guards.GUARDS if one not in false_alarms))
            session = start(scene, keep=False, unstable=False, judges_energy=True, **hub.options, **options)
        session._loop.control.silence_ns = round(1e9 * PATIENCE_S)
        return session

    served = Served(hub, starting(scene), view, warnings, starting)
    hub.observer.begun(served.is_over.set)
    hub.observer.started(served.session)
    ended = threading.Thread(target=lambda: _end(served, server))
    ended.start()
    try:
        yield served
    finally:
        served.is_over.set()
        ended.join()


def _end(served: Served, server: Server) -> None:
    """Follows the session to its end, as the run does."""
    while not served.is_over.is_set():
        session = served.session
        if session.wait(0.02) and not served.is_paused and session is served.session:
            break
    failure = None
    try:
        served.session.close()
    except RunError as error:
        failure = error
        print(f"the served run ended: {error}")
    served.hub.observer.over()
    served.hub.ended(failure)
    server.close()
