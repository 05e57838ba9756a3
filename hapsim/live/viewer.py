"""One client of the WebSocket: its requests are answered in order; events and samples are sent meanwhile."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Callable
from typing import Any, Protocol

from pydantic import BaseModel
from websockets.asyncio.server import ServerConnection
from websockets.exceptions import ConnectionClosed

from hapsim.errors import HapsimError, UsageError
from hapsim.live.blocks import block_of, modules_block, place_of, thinned
from hapsim.live.hub import Hub
from hapsim.live.messages import (
    Adopt,
    Done,
    Get,
    Marker,
    Predict,
    Predicted,
    Record,
    Rejected,
    Set,
    Stop,
    Subscribe,
    request_of,
    text_of,
)
from hapsim.recording.feed import Stream
from hapsim.running.session import Session

PATIENCE_S = 5.0
"""How long a client may take nothing of what waits for it."""
MESSAGES_PER_S = 2000.0
"""Of one client; more are read later."""
SLOWLY, GOING_AWAY = 1013, 1001

_MOST_EVENTS = 1000  # that wait
_MOST_ANSWERS = 256
_BLOCK_VALUES = 1 << 17  # of one block
_CLOSING_S = 1.0


class Office(Protocol):
    """What a viewer asks of who serves it."""

    hub: Hub
    rejected: int

    def model(self, id: Any) -> BaseModel:
        """Returns the answer to `get`."""

    def counters(self, session: Session) -> str:
        """Returns the message with the counters."""

    async def beside(self, work: Callable[[], Any], is_prediction: bool = False) -> Any:
        """Returns what `work`, which takes long, returns in a thread of its own."""

    def report(self, sentence: str) -> None:
        """Prints a warning."""


class Viewer:
    """Serves one connection."""

    def __init__(self, office: Office, socket: ServerConnection) -> None:
        self._office, self._socket = office, socket
        self._answers: asyncio.Queue[asyncio.Task[BaseModel]] = asyncio.Queue(_MOST_ANSWERS)
        self._events: asyncio.Queue[str | None] = asyncio.Queue(_MOST_EVENTS)
        self._feed: asyncio.Task[None] | None = None
        self._going: asyncio.Task[None] | None = None
        self._allowance, self._allowed_at = MESSAGES_PER_S, 0.0

    async def serve(self) -> None:
        """Serves it until it goes, or is dropped."""
        tasks = [asyncio.create_task(one()) for one in (self._write_answers, self._write_events)]
        try:
            async for text in self._socket:
                await self._wait_for_allowance()
                task = asyncio.create_task(self._answer(text))
                await self._answers.put(task)
                await asyncio.sleep(0)
        except ConnectionClosed:
            pass
        finally:
            left = [self._answers.get_nowait() for _ in range(self._answers.qsize())]
            for one in (*tasks, *left, *([self._feed] if self._feed else [])):
                one.cancel()

    def tell(self, text: str | None) -> None:
        """Sends an event soon. None: closes the connection once all are sent."""
        try:
            self._events.put_nowait(text)
        except asyncio.QueueFull:
            self._drop()

    # Requests

    async def _answer(self, text: str | bytes) -> BaseModel:
        id = None
        try:
            request = request_of(text)
            id = request.id
            return await self._carried_out(request)
        except HapsimError as error:
            self._office.rejected += 1
            return Rejected(id=id, reason=str(error))

    async def _carried_out(self, request: Any) -> BaseModel:
        hub, office = self._office.hub, self._office
        file = None
        match request:
            case Get():
                return office.model(request.id)
            case Set():
                await asyncio.wrap_future(hub.set(request.values, request.over))
            case Subscribe():
                self._subscribe(request)
            case Marker():
                hub.mark(request.text)
            case Stop():
                hub.stop()
            case Adopt():
                await office.beside(lambda: hub.adopt(request.scene, request.over))
            case Record():
                file = await office.beside(lambda: hub.record(request.on))
            case Predict():
                from hapsim.live.plane import predicted

                scene, parameters = hub.scene, hub.parameters
                found = await office.beside(
                    lambda: predicted(scene, parameters, request.values, request.hand, request.plane),
                    is_prediction=True,
                )
                return Predicted(id=request.id, **found)
        return Done(id=request.id, file=None if file is None else str(file))

    async def _write_answers(self) -> None:
        while True:
            await self._send(text_of(await (await self._answers.get())))

    async def _write_events(self) -> None:
        while (text := await self._events.get()) is not None:
            await self._send(text)
        with contextlib.suppress(ConnectionClosed):
            async with asyncio.timeout(_CLOSING_S):
                await self._socket.close(GOING_AWAY, "the run has ended")

    async def _wait_for_allowance(self) -> None:
        """Waits where more messages came than allowed: what is not read yet waits at the client."""
        now = asyncio.get_running_loop().time()
        self._allowance += (now - self._allowed_at) * MESSAGES_PER_S
        self._allowance, self._allowed_at = min(self._allowance, MESSAGES_PER_S) - 1.0, now
        if self._allowance < 0.0:
            await asyncio.sleep(-self._allowance / MESSAGES_PER_S)

    # Samples

    def _subscribe(self, wanted: Subscribe) -> None:
        state = self._office.hub.state()
        for name in wanted.modules if state is not None else ():
            place_of(state, name)  # type: ignore[arg-type]
        if self._feed is not None:
            self._feed.cancel()
        self._feed = asyncio.create_task(self._stream(wanted)) if wanted.rate > 0 else None

    async def _stream(self, wanted: Subscribe) -> None:
        """Sends what was subscribed to, of every session that runs."""
        clock = asyncio.get_running_loop().time
        session: Session | None = None
        stream: Stream | None = None
        due = counted = clock()
        sent = 0
        while True:
            if session is not None and stream is not None:
                sent += await self._send_samples(session, stream, wanted, sent)
            if self._office.hub.session is not session:
                session, sent = self._office.hub.session, 0
                stream = None if session is None else session.stream(wanted.history)
            elif session is not None:
                if wanted.modules:
                    await self._send_modules(session, wanted)
                if clock() >= counted:
                    counted = clock() + 1.0
                    await self._send(self._office.counters(session))
            due = max(due + 1.0 / wanted.rate, clock())
            await asyncio.sleep(max(due - clock(), 0.0))

    async def _send_samples(self, session: Session, stream: Stream, wanted: Subscribe, sent: int) -> int:
        """Sends all samples that are there, in blocks; returns how many there were."""
        scene, count = session.scene, 0
        most = max(1, _BLOCK_VALUES // (2 + 3 * scene.channels))
        while True:
            try:
                samples = stream.take(most)
            except UsageError:  # of a run in virtual time, which waits for nobody: the numbers show the gap
                continue
            if samples is None:
                return count
            kept = thinned(samples, wanted.every, sent + count)
            count += len(samples)
            if len(kept):
                await self._send(block_of(kept, scene.period))
            if len(samples) < most:
                return count
            await asyncio.sleep(0)

    async def _send_modules(self, session: Session, wanted: Subscribe) -> None:
        with contextlib.suppress(UsageError):  # another scene may not have them
            await self._send(modules_block(session.state(), wanted.modules, session.scene.period))

    # Sending

    async def _send(self, message: str | bytes) -> None:
        """Sends a message. Drops a client that takes nothing for too long."""
        try:
            async with asyncio.timeout(PATIENCE_S):
                await self._socket.send(message)
        except TimeoutError:
            self._drop()
        except ConnectionClosed:
            pass

    def _drop(self) -> None:
        """Has a client go that is too slow, and says so, to it and on the console."""
        if self._going is None:
            place = str((self._socket.remote_address or ("?",))[0])
            self._office.report(f"a client at {place} was dropped: it reads too slowly what it subscribed to")
            self._going = asyncio.create_task(self._dropped())

    async def _dropped(self) -> None:
        with contextlib.suppress(TimeoutError, ConnectionClosed):
            async with asyncio.timeout(_CLOSING_S):
                await self._socket.close(SLOWLY, "too slow: read what you subscribe to, or subscribe to less")
        self._socket.transport.abort()
