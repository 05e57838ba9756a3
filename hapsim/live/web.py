"""The page and the WebSocket of a running scene, on one port. `viewer` serves one client of the WebSocket."""

from __future__ import annotations

import asyncio
import mimetypes
import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict
from http import HTTPStatus
from pathlib import Path
from typing import Any

from websockets.asyncio.server import Server, ServerConnection
from websockets.http11 import Request, Response

import hapsim
from hapsim.live.access import TOKEN_VARIABLE, Address, has_token, new_token, why_refused
from hapsim.live.hub import Hub
from hapsim.live.messages import (
    LONGEST,
    Bins,
    Channel,
    Counters,
    Drag,
    EventMessage,
    Model,
    ModuleMessage,
    ParameterMessage,
    text_of,
)
from hapsim.live.server import response, serve_at
from hapsim.live.viewer import GOING_AWAY, TRY_LATER, Viewer
from hapsim.loop.counts import words_at
from hapsim.loop.histogram import Histogram
from hapsim.running.parameters import Parameter
from hapsim.running.session import Session
from hapsim.running.session_view import Event
from hapsim.scene import Scene

MOST_CLIENTS = 16
_CLOSING_S = 2.0
_FOLDER = Path(__file__).with_name("page")
SCHEMA = Path(__file__).with_name("messages.json")
_TOGETHER_S = 1 / 60  # changes within it are one event


class WebView:
    """Serves a hub at an address. `report` prints a warning."""

    def __init__(self, hub: Hub, address: Address, report: Callable[[str], None]) -> None:
        self.hub, self.address, self.report = hub, address, report
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
        """Where a browser finds the page."""
        return f"http://{self.address}/" + (f"?token={self._token}" if self._token else "")

    # As a View

    async def start(self, loop: asyncio.AbstractEventLoop) -> None:
        """Begins to listen. Raises UsageError where the port is taken or the address is another machine's."""
        self._loop = loop
        self._server: Server
        self._server, self.address = await serve_at(self.address, "--serve", self._process, self._serve, LONGEST)
        self._unlisten = self.hub.listen(lambda event: self._call(self._heard, event))

    async def close(self) -> None:
        """Sends what is left, closes all connections."""
        self._unlisten()
        self._tell_changed()
        self._is_closing = True
        tasks = [task for task in self._viewers.values() if task is not None]
        for viewer in self._viewers:
            viewer.tell(None)
        if tasks:
            await asyncio.wait(tasks, timeout=_CLOSING_S)
        self._server.close()
        await self._server.wait_closed()
        for one in (self._slow, self._predictor):
            one.shutdown(wait=False, cancel_futures=True)

    def _call(self, function: Callable[..., None], *arguments: Any) -> None:
        """From any thread."""
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
            return response(HTTPStatus.OK, text_of(dict(words_at("live"))), "application/json")
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

    async def beside(self, work: Callable[[], Any], is_prediction: bool = False) -> Any:
        """Returns what `work` returns in another thread."""
        return await self._loop.run_in_executor(self._predictor if is_prediction else self._slow, work)

    def model(self, id: Any) -> Model:
        """Returns the answer to `get`."""
        hub, scene, session = self.hub, self.hub.scene, self.hub.session
        return Model(
            id=id,
            version=hapsim.__version__,
            scene=hub.name,
            title=Path(hub.name).stem.replace("_", " "),
            rate_hz=scene.rate,
            phase=hub.phase,
            channels=_channels(scene),
            parameters=[_parameter(one) for one in hub.parameters.values()],
            modules=_modules(session),
            has_mock=session is not None and session.has_mock,
            can_record=hub.record_dir is not None,
            recording=None if session is None or session.recording is None else str(session.recording),
            events=[_event(one) for one in list(hub.events)[-100:]],
        )

    def counters(self, session: Session) -> str:
        """Returns the message with the counters."""
        statistics = session.statistics()
        return text_of(
            Counters(
                progress=asdict(session.progress()),
                exchange=_bins(statistics.exchange),
                lateness=_bins(statistics.lateness),
                age=_bins(statistics.age),
                clients=len(self._viewers),
                rejected=self.rejected,
            )
        )

    # Events

    def _heard(self, event: Event) -> None:
        """Tells all viewers. What changes within a moment is one event; so is what is rejected."""
        if event.kind == "changed" and event.values:
            self._changed |= event.values
            self._last_change = event
            if self._flush is None:
                self._flush = self._loop.call_later(_TOGETHER_S, self._tell_changed)
            return
        if event.kind == "rejected":
            if self._loop.time() < self._rejected_at + _TOGETHER_S:
                return
            self._rejected_at = self._loop.time()
        self._tell_changed()
        self._tell_all(_event(event))

    def _tell_changed(self) -> None:
        if self._flush is not None:
            self._flush.cancel()
            self._flush, values, self._changed = None, self._changed, {}
            last = self._last_change
            self._tell_all(EventMessage(kind="changed", sentence="", values=values, sample=last.sample, at=last.at))

    def _tell_all(self, message: EventMessage) -> None:
        text = text_of(message)
        for viewer in self._viewers:
            viewer.tell(text)


def _event(event: Event) -> EventMessage:
    values = dict(event.values)
    return EventMessage(kind=event.kind, sentence=event.sentence, values=values, sample=event.sample, at=event.at)


def _parameter(one: Parameter) -> ParameterMessage:
    names = ("name", "kind", "value", "unit", "description", "least", "most", "words", "span")
    return ParameterMessage(**{name: getattr(one, name) for name in names}, logarithmic=one.is_logarithmic)


def _channels(scene: Scene) -> list[Channel]:
    motions, travels = scene.device.motions(scene.channels), scene.device.travels(scene.channels)
    names = {point.channel: name for name, point in scene.device_points.items()}
    return [
        Channel(
            channel=i,
            name=names.get(i, ""),
            motion=motion,
            unit_position="rad" if motion == "rotary" else "m",
            unit_force="N·m" if motion == "rotary" else "N",
            force_limit=scene.device.force_limit,
            travel=travels[i],
            hand=Drag(stiffness=scale.drag_stiffness, damping=scale.drag_damping, reach=scale.reach),
        )
        for i, (motion, scale) in enumerate(zip(motions, scene.device.scales(scene.channels), strict=True))
    ]


def _modules(session: Session | None) -> list[ModuleMessage]:
    if session is None:
        return []
    found = []
    for name, place in session.state().modules.items():
        columns = getattr(session.scene.modules.get(name), "columns", None)
        found.append(ModuleMessage(name=name, masses=None if isinstance(place, float) else place.size, columns=columns))
    return found


def _bins(histogram: Histogram) -> Bins:
    there = histogram.counts.nonzero()[0]
    return Bins(edges_s=histogram.edges[there].tolist(), counts=histogram.counts[there].tolist())
