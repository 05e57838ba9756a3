"""The mock as a process of its own: prints where it is, serves until a signal tells it to stop."""

from __future__ import annotations

import contextlib
import signal
from collections.abc import Callable, Iterator
from pathlib import Path
from queue import SimpleQueue

from hapsim.compiling.progress import Counted, on_compilation
from hapsim.device.mock.assemble import assemble_mock
from hapsim.device.mock.terminal import require_pseudo_terminal, serving
from hapsim.device.port_name import free_name, give_name, take_name
from hapsim.progress import Progress
from hapsim.scene import Scene


def serve_until_stopped(
    scene: Scene,
    link: Path | None,
    announce: Callable[[str], None],
    tell: Callable[[Progress], None],
    as_hardware: bool = False,
) -> None:
    """Serves the scene's mock; `announce(path)` once it answers. SIGINT, SIGTERM and SIGHUP end it in good order.

    `link`: a further name for the port, made as a symbolic link and taken away at the end. UsageError where that name
    is taken. `as_hardware`: before every other program, where the system grants that.
    """
    require_pseudo_terminal()  # before anything is changed
    free_name(link)
    # A queue, and not an event: a handler that sets one while it is waited for may wait for the event's own lock.
    stops: SimpleQueue[None] = SimpleQueue()
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, lambda _number, _frame: stops.put(None))
    with (
        on_compilation(Counted(lambda name, share: tell(Progress("compiling", name, share=share))).add),
        serving(assemble_mock(scene), as_hardware) as path,
        _linked(link, path) as name,
    ):
        if not stops.empty():
            raise KeyboardInterrupt  # before it was announced: nobody shall take it for a port that answers
        announce(name)
        tell(Progress("serving", name))
        stops.get()


@contextlib.contextmanager
def _linked(link: Path | None, path: str) -> Iterator[str]:
    if link is None:
        yield path
        return
    give_name(link, path)
    try:
        yield str(link)
    finally:
        take_name(link, path)
