"""A run from beginning to end, for those who want its trace."""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from typing import Unpack

from hapsim.progress import Progress
from hapsim.recording.trace import Trace
from hapsim.running.session import Session
from hapsim.running.starting import StartOptions, start
from hapsim.scene import Scene
from hapsim.stopping import stopping_on_signals

_LOOK_S = 0.05  # how often the live line looks at the loop


def run(
    scene: Scene,
    *,
    on_start: Callable[[Session], None] | None = None,
    stop_on_signals: bool = False,
    **options: Unpack[StartOptions],
) -> Trace:
    """Runs `scene` until it ends and returns what happened.

    `on_start`: called once it runs; `stop_on_signals`: SIGINT, SIGTERM and SIGHUP end the run in good order (main
    thread only). `options`: as of `start`; `on_progress` is called now and then while it runs, too. The errors as
    `start`.
    """
    tell = options.get("on_progress") or (lambda _: None)
    running: list[Session] = []
    stopped: list[bool] = []

    def stop() -> None:
        stopped.append(True)
        if not running:
            raise KeyboardInterrupt  # nothing is armed yet
        running[0].stop()

    def arming(session: Session) -> None:
        if stopped:  # and whoever was interrupted there has passed it over
            raise KeyboardInterrupt
        running.append(session)

    with (
        stopping_on_signals(stop) if stop_on_signals else contextlib.nullcontext(),
        start(scene, on_arming=arming, **options) as session,
    ):
        if on_start is not None:
            on_start(session)
        follow(session, tell)
    return session.trace


def follow(session: Session, tell: Callable[[Progress], None]) -> None:
    """Waits until the session has ended, and tells now and then how it is doing."""
    while not session.wait(_LOOK_S):
        tell(session.progress())
    tell(session.progress())
