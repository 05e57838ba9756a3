"""A run from beginning to end, for those who want its trace."""

from __future__ import annotations

import contextlib
from collections.abc import Callable

from hapsim.device.open_connection import TransportKind
from hapsim.loop.trace import Trace
from hapsim.progress import Progress
from hapsim.running.excitation import Excitation
from hapsim.running.session import Session, start
from hapsim.running.signals import stopping_on_signals
from hapsim.scene import Scene

_LOOK_S = 0.05  # how often the live line looks at the loop


def run(
    scene: Scene,
    *,
    duration: float | None = None,
    transport: TransportKind = "auto",
    excitation: Excitation | None = None,
    keep: bool = True,
    realtime: bool = False,
    portable: bool = False,
    on_progress: Callable[[Progress], None] | None = None,
    on_start: Callable[[Session], None] | None = None,
    stop_on_signals: bool = False,
) -> Trace:
    """Runs `scene` for `duration` seconds (None: until stopped) and returns what happened.

    `on_progress`: called now and then while it runs, `on_start` once it does; `stop_on_signals`: SIGINT, SIGTERM and
    SIGHUP end the run in good order (main thread only). The rest, and the errors, as `start`.
    """
    tell = on_progress or (lambda _: None)
    running: list[Session] = []

    def stop() -> None:
        if not running:
            raise KeyboardInterrupt  # nothing is armed yet
        running[0].stop()

    with (
        stopping_on_signals(stop) if stop_on_signals else contextlib.nullcontext(),
        start(
            scene,
            duration=duration,
            transport=transport,
            excitation=excitation,
            keep=keep,
            realtime=realtime,
            portable=portable,
            on_progress=tell,
            on_arming=running.append,
        ) as session,
    ):
        if on_start is not None:
            on_start(session)
        while not session.wait(_LOOK_S):
            tell(session.progress())
        tell(session.progress())
    return session.trace
