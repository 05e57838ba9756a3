"""One client of the WebSocket: its requests are answered in order; events and samples are sent meanwhile."""

from __future__ import annotations

import asyncio
import contextlib
import struct
from collections.abc import Callable, Sequence
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel
from websockets.asyncio.server import ServerConnection
from websockets.exceptions import ConnectionClosed

from hapsim.errors import HapsimError, UsageError
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
from hapsim.recording.recorder import Samples, Stream
from hapsim.running.session import Session

PATIENCE_S = 5.0
"""How long a client may take nothing of what waits for it."""
MESSAGES_PER_S = 2000.0
"""Of one client; more are read later."""
GOING_AWAY, TRY_LATER = 1001, 1013

_MOST_EVENTS = 1000  # that wait
_MOST_ANSWERS = 32
_BLOCK_VALUES = 1 << 17  # of one block
_GLANCE_S = 2e-3  # between two at what is watched
_CLOSING_S = 1.0


class Office(Protocol):
    """What a viewer asks of who serves it."""

    hub: Hub
    rejected: int

    def model(self, id: Any) -> BaseModel: ...

    def counters(self, session: Session) -> str: ...

    async def beside(self, work: Callable[[], Any], is_prediction: bool = False) -> Any: ...

    report: Callable[[str], None]


class Viewer:
    """Serves one connection."""

    def __init__(self, office: Office, socket: ServerConnection) -> None:
        self._office, self._socket = office, socket
        self._answers: asyncio.Queue[asyncio.Task[BaseModel]] = asyncio.Queue(_MOST_ANSWERS)
        self._events: asyncio.Queue[str | None] = asyncio.Queue(_MOST_EVENTS)
        self._ending = asyncio.Event()
        self._adopting: asyncio.Task[Any] | None = None  # the latest
        self._feed: asyncio.Task[None] | None = None
        self._subscribing = asyncio.Lock()
        self._going: asyncio.Task[None] | None = None
        self._allowance, self._allowed_at = MESSAGES_PER_S, 0.0

    async def serve(self) -> None:
        """Serves it until it goes, or is dropped."""
        tasks: list[asyncio.Task[Any]] = [asyncio.create_task(self._write_answers())]
        tasks.append(asyncio.create_task(self._write_events()))
        try:
            async for text in self._socket:
                await self._wait_for_allowance()
                await self._answers.put(asyncio.create_task(self._answer(text)))
        except ConnectionClosed:
            pass
        finally:
            tasks += [self._answers.get_nowait() for _ in range(self._answers.qsize())]
            for one in (*tasks, *([self._feed] if self._feed else [])):
                one.cancel()

    def tell(self, text: str | None) -> None:
        """Sends an event soon. None: closes the connection once everything is sent."""
        try:
            self._events.put_nowait(text)
        except asyncio.QueueFull:
            self._drop()

    # Requests

    async def _answer(self, text: str | bytes) -> BaseModel:
        id = None
        try:
            request = request_of(text)
            id, before = request.id, self._adopting
            if isinstance(request, Adopt):
                self._adopting = asyncio.current_task()
            if before is not None and not isinstance(request, Stop):  # what follows a scene is meant for it
                await asyncio.wait([before])
            return await self._carried_out(request)
        except Exception as error:
            self._office.rejected += 1
            known = isinstance(error, HapsimError)
            return Rejected(id=id, reason=str(error) if known else f"a defect of hapsim itself: {error!r}")

    async def _carried_out(self, request: Any) -> BaseModel:
        hub, office, file = self._office.hub, self._office, None
        match request:
            case Get():
                return office.model(request.id)
            case Set():
                await asyncio.wrap_future(hub.set(request.values, request.over))
            case Subscribe():
                await self._subscribe(request)
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
                    lambda: predicted(scene, parameters, request),
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
        self._ending.set()
        with contextlib.suppress(ConnectionClosed, TimeoutError):
            async with asyncio.timeout(_CLOSING_S):
                if self._feed is not None:
                    await asyncio.wait([self._feed])
                await self._socket.close(GOING_AWAY, "the run has ended")

    async def _wait_for_allowance(self) -> None:
        """Waits where more messages came than allowed: what is not read yet waits at the client."""
        now = asyncio.get_running_loop().time()
        self._allowance += (now - self._allowed_at) * MESSAGES_PER_S
        self._allowance, self._allowed_at = min(self._allowance, MESSAGES_PER_S) - 1.0, now
        if self._allowance < 0.0:
            await asyncio.sleep(-self._allowance / MESSAGES_PER_S)

    # Samples

    async def _subscribe(self, wanted: Subscribe) -> None:
        session = self._office.hub.session
        if session is not None:
            session.positions(wanted.modules)
        async with self._subscribing:  # one request after the other, or a feed would be left that nothing ends
            if self._feed is not None:  # first, or blocks of both would be mixed
                self._feed.cancel()
                await asyncio.wait([self._feed])
            self._feed = asyncio.create_task(self._stream(wanted)) if wanted.rate > 0 else None
            if self._feed is not None:
                self._feed.add_done_callback(self._fed)

    def _fed(self, feed: asyncio.Task[None]) -> None:
        if not feed.cancelled() and (error := feed.exception()) is not None:
            self._office.report(f"a client is sent nothing more for a defect of hapsim itself: {error!r}")

    async def _stream(self, wanted: Subscribe) -> None:
        """Sends what was subscribed to, of every session that runs."""
        clock = asyncio.get_running_loop().time
        session: Session | None = None
        stream: Stream | None = None
        due, counted, sent, is_last = clock(), 0.0, 0, False
        while not is_last:
            is_last = self._ending.is_set()
            if session is not None and stream is not None:
                sent += await self._send_samples(session, stream, wanted, sent)
            if self._office.hub.session is not session:
                session, sent = self._office.hub.session, 0
                stream = None if session is None else session.stream(wanted.history)
                continue
            if session is not None and clock() >= counted:
                counted = clock() + 1.0
                await self._send(self._office.counters(session))
            due = max(due + 1.0 / wanted.rate, clock())
            await self._watch(session, wanted, due)

    async def _send_samples(self, session: Session, stream: Stream, wanted: Subscribe, sent: int) -> int:
        """Sends all samples that are there, in blocks; returns how many there were."""
        scene, count = session.scene, 0
        most = max(1, _BLOCK_VALUES // (2 + 3 * scene.channels))
        while True:
            try:
                samples = stream.take(most)
            except UsageError:  # too many waited, of a run in virtual time, that waits for nobody: numbers show the gap
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

    async def _watch(self, session: Session | None, wanted: Subscribe, due: float) -> None:
        """Waits until `due` or the end, and sends where watched modules were meanwhile."""
        clock, glances = asyncio.get_running_loop().time, list[Any]()
        is_over = False
        while not is_over:
            if session is not None and wanted.modules:
                with contextlib.suppress(UsageError):  # another scene may not have them
                    glance = session.positions(wanted.modules)
                    glances += [glance] if not glances or glance[0] > glances[-1][0] else []
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout_at(min(due, clock() + _GLANCE_S) if wanted.modules else due):
                    await self._ending.wait()
            is_over = self._ending.is_set() or clock() >= due
        if session is not None and glances:
            await self._send(modules_block(glances, session.scene.channels, session.scene.period))

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
                await self._socket.close(TRY_LATER, "too slow: read what you subscribe to, or subscribe to less")
        self._socket.transport.abort()


SAMPLES, MODULES = 1, 2
"""Kinds of a block."""
HEAD = struct.Struct("<IIIIdd")
"""Kind, rows, columns, channels, number of the first sample, sample period in s."""


def block_of(samples: Samples, period: float) -> bytes:
    """Returns a block with a row for each sample: [sample − first, flags, position × C, velocity × C, force × C].
    `period`: s between two samples."""
    first, channels = int(samples.sample[0]), samples.position.shape[1]
    rows = np.column_stack(
        [samples.sample - first, samples.flags, samples.position, samples.velocity, samples.force]
    ).astype("<f4")
    return HEAD.pack(SAMPLES, *rows.shape, channels, first, period) + rows.tobytes()


def thinned(samples: Samples, every: int, before: int) -> Samples:
    """Returns every n-th of the samples that follow `before` others."""
    if every == 1:
        return samples
    kept = slice(-before % every, None, every)
    return Samples(**{name: values[kept] for name, values in vars(samples).items()})


def modules_block(glances: Sequence[tuple[int, NDArray[np.float64]]], channels: int, period: float) -> bytes:
    """Returns a block with a row for each glance at watched modules, a sample's number and (modules,) positions in m:
    [sample − first, position of each]."""
    first = glances[0][0]
    rows = np.array([[sample - first, *places] for sample, places in glances], "<f4")
    return HEAD.pack(MODULES, *rows.shape, channels, first, period) + rows.tobytes()
