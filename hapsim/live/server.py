"""The server of a running scene: one thread with one asyncio loop, in which every view lives.

The thread touches the haptic loop only through what a `Hub` offers, and has a lower priority.
"""

from __future__ import annotations

import asyncio
import contextlib
import gc
import logging
import os
import threading
from collections.abc import Callable, Sequence
from concurrent.futures import Future
from typing import Any, Protocol

_THREAD = "live server"
logging.getLogger("asyncio").addFilter(lambda record: record.threadName != _THREAD)  # writes to who is gone

_NICE = 10  # the loop, and the thread that makes changes, have 0
_PATIENCE_S = 3.0  # with views that close
_COLLECT_S = 10.0


class View(Protocol):
    """What shows a running scene to somebody, over a network."""

    @property
    def url(self) -> str:
        """Where it is, once started; "" where no URL says that."""

    async def start(self, loop: asyncio.AbstractEventLoop) -> None:
        """Opens its sockets. Raises UsageError where it cannot."""

    async def close(self) -> None:
        """Ends what it does: says that the run is over, and closes its sockets."""


class Server:
    """Runs views in a thread of its own, from `start` to `close`."""

    def __init__(self, views: Sequence[View], report: Callable[[str], None], gives_way: bool = True) -> None:
        """`report` prints a warning. `gives_way`: the thread has a lower priority than others; not beside a loop in
        Python."""
        self._views, self._report, self._gives_way = views, report, gives_way
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
        if self._gives_way:
            with contextlib.suppress(OSError, AttributeError):
                os.setpriority(os.PRIO_PROCESS, threading.get_native_id(), _NICE)
        asyncio.run(self._serve())

    async def _serve(self) -> None:
        self._loop, self._stop = asyncio.get_running_loop(), asyncio.Event()
        self._loop.set_exception_handler(
            lambda _, about: self._report(f"a defect of hapsim itself: {_in_words(about)}")
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
                _collect_what_clients_left()
        except Exception as error:
            self._started.set_exception(error)
        finally:
            await asyncio.gather(*(_closed(view.close) for view in open_views), return_exceptions=True)


def _collect_what_clients_left() -> None:
    """Collects garbage where nothing else does: with real-time privileges (`hapsim.loop.realtime`) the collector is off
    and all older objects are set aside, so this takes milliseconds, in which the haptic loop runs on."""
    if not gc.isenabled():
        gc.collect()


async def _closed(close: Callable[[], object]) -> None:
    async with asyncio.timeout(_PATIENCE_S):
        await close()  # type: ignore[misc]


def _in_words(about: dict[str, Any]) -> str:
    return f"{about.get('message', '')}: {about.get('exception')!r}"
