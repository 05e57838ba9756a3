"""The server of a running scene: one thread with one asyncio loop, in which every view lives; and what the views on
TCP share: their sockets, and how they answer requests.

The thread touches the haptic loop only through what a `Hub` offers, and has a lower priority.
"""

from __future__ import annotations

import asyncio
import contextlib
import gc
import logging
import os
import socket
import threading
from collections.abc import Awaitable, Callable, Sequence
from concurrent.futures import Future
from http import HTTPStatus
from typing import Protocol

from websockets.asyncio.server import Server as SocketServer
from websockets.asyncio.server import ServerConnection, serve
from websockets.datastructures import Headers
from websockets.http11 import Request, Response

from hapsim.errors import UsageError
from hapsim.live.access import Address

_THREAD = "live server"
logging.getLogger("asyncio").addFilter(lambda record: record.threadName != _THREAD)  # writes to who is gone

_NICE = 10  # the loop, and the thread that makes changes, have 0
_PATIENCE_S = 3.0  # with views that close
_COLLECT_S = 10.0


class View(Protocol):
    """View of a running scene over a network."""

    WHAT: str
    """Name of the view, with which a line about its URL begins."""

    @property
    def url(self) -> str:
        """URL of the view once it has started."""

    async def start(self, loop: asyncio.AbstractEventLoop) -> None:
        """Opens its sockets. Raises UsageError where it cannot."""

    async def close(self) -> None:
        """Ends what it does: says that the run is over, and closes its sockets."""


class Server:
    """Runs views in a thread of its own, from `start` to `close`."""

    def __init__(self, views: Sequence[View], report: Callable[[str], None], idle_priority: bool = True) -> None:
        """`report` prints a warning. `idle_priority`: of the thread; False beside a loop in Python."""
        self._views, self._report, self._idle_priority = views, report, idle_priority
        self._loop: asyncio.AbstractEventLoop
        self._stop: asyncio.Event
        self._thread = threading.Thread(target=self._run, name=_THREAD, daemon=True)
        self._started: Future[None] = Future()

    def start(self) -> None:
        """Returns once all views can be reached. Raises UsageError where one cannot be."""
        self._thread.start()
        self._started.result()

    def close(self) -> None:
        """Ends the views and the thread."""
        with contextlib.suppress(RuntimeError):  # it has ended
            self._loop.call_soon_threadsafe(self._stop.set)
        self._thread.join(2 * _PATIENCE_S)

    def _run(self) -> None:
        if self._idle_priority:
            with contextlib.suppress(OSError, AttributeError):
                os.setpriority(os.PRIO_PROCESS, threading.get_native_id(), _NICE)
        asyncio.run(self._serve())

    async def _serve(self) -> None:
        self._loop, self._stop = asyncio.get_running_loop(), asyncio.Event()
        self._loop.set_exception_handler(
            lambda _, about: self._report(
                f"a defect of hapsim itself: {about.get('message', '')}: {about.get('exception')!r}"
            )
        )
        open_views: list[View] = []
        try:
            for view in self._views:
                await view.start(self._loop)
                open_views.append(view)
            self._started.set_result(None)
            while not self._stop.is_set():
                with contextlib.suppress(TimeoutError):
                    await asyncio.wait_for(self._stop.wait(), _COLLECT_S)
                # With real-time privileges (`hapsim.loop.realtime`) the collector is off and all older objects are set
                # aside, so what clients left takes milliseconds, in which the haptic loop runs on.
                if not gc.isenabled():
                    gc.collect()
        except Exception as error:
            self._started.set_exception(error)
        finally:
            await asyncio.gather(*(_closed(view.close) for view in open_views), return_exceptions=True)


async def _closed(close: Callable[[], object]) -> None:
    async with asyncio.timeout(_PATIENCE_S):
        await close()  # type: ignore[misc]


_SEND_BUFFER = 1 << 18  # bytes of one client
_SECURITY = {
    "Cache-Control": "no-store",
    "Content-Security-Policy": "default-src 'self'; img-src 'self' data:; frame-ancestors 'none'; base-uri 'none'",
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
}


async def serve_at(
    address: Address,
    option: str,
    process: Callable[[ServerConnection, Request], Response | None],
    handle: Callable[[ServerConnection], Awaitable[None]],
    longest: int,
) -> tuple[SocketServer, Address]:
    """Serves requests and WebSockets. `option`: that asked for it. `process`: answers a request, or lets a WebSocket
    open, which `handle` serves; `longest`: bytes of a message. Returns the server and where it listens (port 0: one
    that is free). Raises UsageError where the port is taken or the address is another machine's."""
    listening = _listening(address, option)
    server = await serve(
        handle,
        sock=listening,
        process_request=process,
        compression=None,
        max_size=longest,
        max_queue=4,
        close_timeout=1.0,
        open_timeout=5.0,
        logger=logging.Logger("hapsim.live", logging.CRITICAL + 1),  # a bad handshake is nobody's news
        server_header=None,
    )
    return server, address._replace(port=listening.getsockname()[1])


def response(status: HTTPStatus, body: str | bytes, kind: str = "", own: dict[str, str] | None = None) -> Response:
    """Returns an answer. `kind`: its content type [default: plain text]; `own`: further headers."""
    body = body.encode() if isinstance(body, str) else body
    headers = {"Content-Type": kind or "text/plain; charset=utf-8", "Content-Length": str(len(body))}
    return Response(
        status, status.phrase, Headers({**headers, "Connection": "close", **_SECURITY, **(own or {})}), body
    )


def free_port(address: Address, option: str) -> int:
    """A port at which nothing is connected by TCP. Raises UsageError as `serve_at`."""
    with _listening(address, option) as listening:
        return int(listening.getsockname()[1])


def _listening(address: Address, option: str) -> socket.socket:
    family = socket.AF_INET6 if ":" in address.ip else socket.AF_INET
    try:
        listening = socket.create_server((address.ip, address.port), family=family)
        listening.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _SEND_BUFFER)  # the system's may grow to megabytes
        # Connections inherit it. asyncio sets it only where a socket names its protocol; else an answer after an event
        # waits 40 ms for the client's acknowledgement.
        listening.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        return listening
    except OSError as error:
        raise UsageError(
            f"{option}: {address} cannot be listened to: {os.strerror(error.errno or 0)}; name another address, or a "
            f"port that is free, with {option}-at HOST:PORT"
        ) from error
