"""The page and the WebSocket of a running scene, on one port."""

from __future__ import annotations

import asyncio
import contextlib
import mimetypes
import os
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import asdict
from http import HTTPStatus
from pathlib import Path
from typing import Any

from pydantic import BaseModel
from websockets.asyncio.server import Server, ServerConnection
from websockets.exceptions import ConnectionClosed
from websockets.http11 import Request, Response

import hapsim
from hapsim.errors import HapsimError, UsageError
from hapsim.live import blocks, messages
from hapsim.live.access import TOKEN_VARIABLE, Address, has_token, ip_of, new_token, why_refused
from hapsim.live.drawn import Picture, drawn_of
from hapsim.live.hub import Hub
from hapsim.live.predicted import predicted
from hapsim.live.server import response, serve_at
from hapsim.live.views import views_of
from hapsim.loop.counts import words_at
from hapsim.recording.recorder import Stream
from hapsim.running.session import Session
from hapsim.running.session_view import Event

MOST_CLIENTS = 16
_CLOSING_S = 2.0  # for all clients
_FOLDER = Path(__file__).with_name("page")
SCHEMA = Path(__file__).with_name("messages.json")
_TOGETHER_S = 1 / 60  # changes within it are one event
PATIENCE_S = 5.0
"""Timeout for a client that takes none of its backlog, s."""
MESSAGES_PER_S = 2000.0
"""Messages per second read from one client; more are read later."""
GOING_AWAY, TRY_LATER = 1001, 1013

_MOST_EVENTS = 1000  # that wait
_MOST_ANSWERS = 32
_MOST_REQUESTS = 1000  # that wait for those: a hand dragged for 10 s while a scene is adopted
_BLOCK_VALUES = 1 << 17  # of one block
_GLANCE_S = 2e-3  # between two at what is watched
_LEAVING_S = 1.0  # for one client
_COUNTERS_S = 1.0  # between two messages of counters
_PICTURE_S = 1 / 30  # between two pictures, at least on average


class WebView:
    """Serves a hub at an address. `report` prints a warning."""

    WHAT = "Page"

    def __init__(self, hub: Hub, address: Address, report: Callable[[str], None], others_save: bool = False) -> None:
        """`others_save`: clients on other machines may save the scene, too."""
        self.hub, self.address, self.report, self.others_save = hub, address, report, others_save
        self.rejected = 0
        """Messages that changed nothing."""
        needs_token = not address.is_loopback or TOKEN_VARIABLE in os.environ
        self._token = new_token() if needs_token else ""
        self._files = {f"/{file.relative_to(_FOLDER)}": file for file in _FOLDER.rglob("*") if file.is_file()}
        self._files |= {"/": _FOLDER / "index.html", "/schema.json": SCHEMA}
        self._viewers: dict[Viewer, asyncio.Task[Any] | None] = {}
        self._is_closing = False
        self._changed: dict[str, Any] = {}
        self._rejected_at = 0.0
        self._flush: asyncio.TimerHandle | None = None
        self._slow, self._predictor = ThreadPoolExecutor(2, "live requests"), ThreadPoolExecutor(1, "live predictions")

    @property
    def url(self) -> str:
        """URL of the page."""
        return f"http://{self.address}/" + (f"?token={self._token}" if self._token else "")

    # As a View

    async def start(self, loop: asyncio.AbstractEventLoop) -> None:
        """Begins to listen. Raises UsageError where the port is taken or the address is another machine's."""
        self._loop = loop
        self._server: Server
        self._server, self.address = await serve_at(
            self.address, "--serve", self._process, self._serve, messages.LONGEST
        )
        self._stop_listening = self.hub.listen(lambda event: self._call(self._receive, event))

    async def close(self) -> None:
        """Sends what is left, closes all connections."""
        self._stop_listening()
        self._send_changed()
        self._is_closing = True
        tasks = [task for task in self._viewers.values() if task is not None]
        for viewer in self._viewers:
            viewer.send(None)
        if tasks:
            await asyncio.wait(tasks, timeout=_CLOSING_S)
        self._server.close()
        await self._server.wait_closed()
        for one in (self._slow, self._predictor):
            one.shutdown(wait=False, cancel_futures=True)

    def _call(self, function: Callable[..., None], *arguments: Any) -> None:
        """Calls a function in the server's event loop, from any thread."""
        if not self._loop.is_closed():
            self._loop.call_soon_threadsafe(function, *arguments)

    # Connections

    def _process(self, _connection: ServerConnection, request: Request) -> Response | None:
        """Answers a request, unless it opens a WebSocket."""
        (path, _, query), headers = request.path.partition("?"), request.headers
        is_live = path == "/live"
        if why := why_refused(self.address, headers.get_all("Host"), headers.get_all("Origin"), needs_origin=is_live):
            return response(HTTPStatus.FORBIDDEN, why)
        cookie = f"hapsim-{self.address.port}"
        if self._token and not has_token(self._token, cookie, query, headers.get_all("Cookie")):
            return response(HTTPStatus.UNAUTHORIZED, "the token is missing or wrong: open the URL that hapsim printed")
        if is_live and "Upgrade" in headers:
            return None
        if path == "/counters.json":  # the page says of a counter what the live line does
            return response(HTTPStatus.OK, messages.text_of(dict(words_at("live"))), "application/json")
        file = self._files.get(path)
        if file is None:
            return response(HTTPStatus.NOT_FOUND, f"{path[:80]}: there is nothing here")
        own = {}
        if self._token and "token=" in query:
            own["Set-Cookie"] = f"{cookie}={self._token}; HttpOnly; SameSite=Lax; Path=/"
            own["Location"] = path
        kind = mimetypes.guess_type(file.name)[0] or "application/octet-stream"
        status = HTTPStatus.SEE_OTHER if own else HTTPStatus.OK
        return response(status, file.read_bytes(), f"{kind}; charset=utf-8", own)

    async def _serve(self, connection: ServerConnection) -> None:
        if self._is_closing or len(self._viewers) >= MOST_CLIENTS:
            reason = "the run has ended" if self._is_closing else f"{MOST_CLIENTS} clients are connected already"
            await connection.close(GOING_AWAY if self._is_closing else TRY_LATER, reason)
            return
        viewer = Viewer(self, connection)
        self._viewers[viewer] = asyncio.current_task()
        try:
            await viewer.serve()
        finally:
            del self._viewers[viewer]

    # What viewers ask

    async def in_thread(self, work: Callable[[], Any], is_prediction: bool = False) -> Any:
        """Returns what `work` returns in another thread."""
        return await self._loop.run_in_executor(self._predictor if is_prediction else self._slow, work)

    def model(self, id: Any, can_save: bool) -> messages.Model:
        """Returns the answer to `get`, of a client that may save the scene or not."""
        hub, scene, session, saved = self.hub, self.hub.scene, self.hub.session, self.hub.saved
        return messages.Model(
            id=id,
            version=hapsim.__version__,
            scene=hub.name,
            title=Path(hub.name).stem.replace("_", " "),
            rate_hz=scene.rate,
            phase=hub.phase,
            channels=messages.channels_of(scene),
            sensed=[] if session is None else list(session.sensed),
            words=[*scene.word_values(0, 0)],
            written={one.si: one[1:] for one in scene.written},
            parameters=[messages.parameter_message(one, saved.get(name)) for name, one in hub.parameters.items()],
            modules=messages.modules_of(session),
            space=scene.space,
            views=views_of(scene, has_mock=session is not None and session.has_mock),
            places={} if session is None else session.state().places,
            drawn=drawn_of(scene),
            has_mock=session is not None and session.has_mock,
            can_record=hub.record_dir is not None,
            can_go_on=hub.can_go_on,
            can_save=can_save,
            file=scene.path and Path(scene.path).name,
            lease={"seconds": None, "out": 0} if session is None else session.lease_state,
            recording=None if session is None or session.recording is None else str(session.recording),
            events=[messages.event_message(one) for one in list(hub.events)[-100:]],
        )

    def counters(self, session: Session) -> str:
        """Returns the message with the counters."""
        statistics = session.statistics()
        return messages.text_of(
            messages.Counters(
                progress=asdict(session.progress()),
                exchange=messages.bins_of(statistics.exchange),
                lateness=messages.bins_of(statistics.lateness),
                age=messages.bins_of(statistics.age),
                clients=len(self._viewers),
                rejected=self.rejected,
            )
        )

    # Events

    def _receive(self, event: Event) -> None:
        """Tells all viewers. What changes within a moment is one event; so is what is rejected."""
        if event.kind == "changed" and event.values:
            self._changed |= event.values
            self._last_change = event
            if self._flush is None:
                self._flush = self._loop.call_later(_TOGETHER_S, self._send_changed)
            return
        if event.kind == "rejected":
            if self._loop.time() < self._rejected_at + _TOGETHER_S:
                return
            self._rejected_at = self._loop.time()
        self._send_changed()
        self._send_to_all(messages.event_message(event))

    def _send_changed(self) -> None:
        if self._flush is not None:
            self._flush.cancel()
            self._flush, values, self._changed = None, self._changed, {}
            last = self._last_change
            self._send_to_all(
                messages.EventMessage(kind="changed", sentence="", values=values, sample=last.sample, at=last.at)
            )

    def _send_to_all(self, message: messages.EventMessage) -> None:
        text = messages.text_of(message)
        for viewer in self._viewers:
            viewer.send(text)


class Viewer:
    """Serves one connection."""

    def __init__(self, view: WebView, socket: ServerConnection) -> None:
        self._view, self._socket = view, socket
        self._requests: asyncio.Queue[str | bytes] = asyncio.Queue(_MOST_REQUESTS)
        self._answers: asyncio.Queue[asyncio.Task[BaseModel]] = asyncio.Queue(_MOST_ANSWERS)
        self._events: asyncio.Queue[str | None] = asyncio.Queue(_MOST_EVENTS)
        self._ending = asyncio.Event()
        self._adopting: asyncio.Task[Any] | None = None  # the latest
        self._feed: asyncio.Task[None] | None = None
        self._subscribing = asyncio.Lock()
        self._going: asyncio.Task[None] | None = None
        self._holds = False  # values that are given back when it goes
        self._allowance, self._allowed_at = MESSAGES_PER_S, 0.0

    async def serve(self) -> None:
        """Serves it until it goes, or is dropped."""
        working = self._take_requests(), self._write_answers(), self._write_events()
        tasks: list[asyncio.Task[Any]] = [asyncio.create_task(one) for one in working]
        try:
            async for text in self._socket:
                await self._wait_for_allowance()
                if _is_stop(text):  # does not wait for what was asked before
                    self._view.hub.stop()
                await self._requests.put(text)
        except ConnectionClosed:
            pass
        finally:
            if self._holds:
                self._view.hub.release()
            tasks += [self._answers.get_nowait() for _ in range(self._answers.qsize())]
            for one in (*tasks, *([self._feed] if self._feed else [])):
                one.cancel()

    def send(self, text: str | None) -> None:
        """Sends an event soon. None: closes the connection once everything is sent."""
        try:
            self._events.put_nowait(text)
        except asyncio.QueueFull:
            self._drop()

    # Requests

    async def _take_requests(self) -> None:
        while True:
            await self._answers.put(asyncio.create_task(self._answer(await self._requests.get())))

    async def _answer(self, text: str | bytes) -> BaseModel:
        id = None
        try:
            request = messages.request_of(text)
            id, before = request.id, self._adopting
            if isinstance(request, messages.Adopt):
                self._adopting = asyncio.current_task()
            if before is not None and not isinstance(request, messages.Stop):  # what follows a scene is meant for it
                await asyncio.wait([before])
            return await self._carried_out(request)
        except Exception as error:
            self._view.rejected += 1
            known = isinstance(error, HapsimError)
            return messages.Rejected(id=id, reason=str(error) if known else f"a defect of hapsim itself: {error!r}")

    async def _carried_out(self, request: Any) -> BaseModel:
        hub, view, file, sample = self._view.hub, self._view, None, None
        match request:
            case messages.Get():
                return await view.in_thread(lambda: view.model(request.id, self._can_save))
            case messages.Set() | messages.Lease():
                await asyncio.wrap_future(self._begun(request))
            case messages.Release():
                self._holds = False
                hub.release()
            case messages.Subscribe():
                await self._subscribe(request)
            case messages.Marker():
                hub.mark(request.text)
            case messages.Stop() | messages.GoOn():
                (hub.stop if isinstance(request, messages.Stop) else hub.go_on)()
            case messages.Adopt():
                await view.in_thread(lambda: hub.adopt(request.scene, request.over))
            case messages.InTurn():
                sample = await asyncio.wrap_future(hub.in_turn(request.make))
            case messages.Record():
                file = await view.in_thread(lambda: hub.record(request.on))
            case messages.Save():  # in a thread: a client that goes meanwhile leaves a whole file
                if not self._can_save:
                    raise UsageError("a client on another machine may not save: start hapsim with --save to allow it")
                file = await view.in_thread(lambda: hub.save(request.name))
            case messages.Predict():
                scene, parameters = hub.scene, hub.parameters
                asked = (scene, parameters, request, hub.words)
                found = await view.in_thread(lambda: predicted(*asked), is_prediction=True)
                return messages.Predicted(id=request.id, **found)
        return messages.Done(id=request.id, file=None if file is None else str(file), sample=sample)

    def _begun(self, request: messages.Set | messages.Lease) -> Future[None]:
        hub = self._view.hub
        if isinstance(request, messages.Lease):
            return hub.lease(request.seconds, request.fallback, self)
        self._holds = self._holds or request.held
        return (hub.hold if request.held else hub.set)(request.values, request.over)

    @property
    def _can_save(self) -> bool:
        """True if the client is on this machine, or others may save, too."""
        own, other = (ip_of(str(one[0])) for one in (self._socket.local_address, self._socket.remote_address))
        return self._view.others_save or other.is_loopback or other == own

    async def _write_answers(self) -> None:
        while True:
            await self._send(messages.text_of(await (await self._answers.get())))

    async def _write_events(self) -> None:
        while (text := await self._events.get()) is not None:
            await self._send(text)
        self._ending.set()
        with contextlib.suppress(ConnectionClosed, TimeoutError):
            async with asyncio.timeout(_LEAVING_S):
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

    async def _subscribe(self, wanted: messages.Subscribe) -> None:
        session = self._view.hub.session
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
            self._view.report(f"a client is sent nothing more for a defect of hapsim itself: {error!r}")

    async def _stream(self, wanted: messages.Subscribe) -> None:
        """Sends what was subscribed to, of every session that runs."""
        clock = asyncio.get_running_loop().time
        session: Session | None = None
        stream: Stream | None = None
        due, counted, sent, is_last = clock(), 0.0, 0, False
        picture, pictured = Picture(), 0.0
        while not is_last:
            is_last = self._ending.is_set()
            if session is not None and stream is not None:
                sent += await self._send_samples(session, stream, wanted, sent)
                if wanted.picture and clock() >= pictured and (row := picture.row(session)) is not None:
                    pictured = max(pictured, clock() - _PICTURE_S) + _PICTURE_S
                    of_scene = session.scene.channels, session.scene.period
                    await self._send(blocks.modules_block([row], *of_scene, blocks.PICTURE))
            if self._view.hub.session is not session:
                session, sent = self._view.hub.session, 0
                stream = None if session is None else session.stream(wanted.history)
                continue
            if session is not None and clock() >= counted:
                counted = clock() + _COUNTERS_S
                await self._send(self._view.counters(session))
            due = max(due + 1.0 / wanted.rate, clock())
            await self._watch(session, wanted, due)

    async def _send_samples(self, session: Session, stream: Stream, wanted: messages.Subscribe, sent: int) -> int:
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
            kept = blocks.thinned(samples, wanted.every, sent + count)
            count += len(samples)
            if len(kept):
                await self._send(blocks.block_of(kept, scene.period))
            if len(samples) < most:
                return count
            await asyncio.sleep(0)

    async def _watch(self, session: Session | None, wanted: messages.Subscribe, due: float) -> None:
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
            await self._send(blocks.modules_block(glances, session.scene.channels, session.scene.period))

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
            self._view.report(f"a client at {place} was dropped: it reads too slowly what it subscribed to")
            self._going = asyncio.create_task(self._dropped())

    async def _dropped(self) -> None:
        with contextlib.suppress(TimeoutError, ConnectionClosed):
            async with asyncio.timeout(_LEAVING_S):
                await self._socket.close(TRY_LATER, "too slow: read what you subscribe to, or subscribe to less")
        self._socket.transport.abort()


def _is_stop(text: str | bytes) -> bool:
    if not (isinstance(text, str) and "stop" in text[: messages.SHORT]):
        return False
    with contextlib.suppress(UsageError):
        return isinstance(messages.request_of(text), messages.Stop)
    return False
