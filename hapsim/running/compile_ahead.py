"""What can be compiled before a run needs it, in two processes side by side.

A run needs the loop and, where the device is a mock in this process, that; neither knows the other. Beside them there
is what scenes are made of. `python -m hapsim.running.compile_ahead mock` is the second process: it prints the name of
each function as it begins, and leaves what it compiled where the first finds it.
"""

from __future__ import annotations

import contextlib
import os
import subprocess
import sys
import threading
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Any, NamedTuple

from firmware_protocol.compiled import new_record
from hapsim.compiling.entries import compile_for, is_kept
from hapsim.compiling.native import PlainNative
from hapsim.compiling.progress import Counted, on_compilation


class _Entry(NamedTuple):
    """An entry, and records of the types that it is compiled for."""

    function: Any
    arguments: tuple[Any, ...]

    def address(self) -> None:
        compile_for(self.function, *self.arguments)

    def is_kept(self) -> bool:
        return is_kept(self.function, *self.arguments)


class _Modules(NamedTuple):
    """Every type of module there is, by every scheme, in one precision."""

    precision: str

    def address(self) -> None:
        """Compiles them, or loads them, by asking each for its address."""
        from hapsim.cordis.program import compile_scene
        from hapsim.cordis.succession import take_over_from
        from hapsim.running.every_module import scenes_with_every_module

        for scene in scenes_with_every_module(self.precision):
            program, following = compile_scene(scene), compile_scene(scene)
            take_over_from(program, scene, following, scene)

    def is_kept(self) -> bool:
        return False  # it takes longer to find out than to load them


class Unit(NamedTuple):
    """What is compiled together."""

    functions: int
    """How many there are to compile, as far as one can tell without compiling them."""
    parts: Callable[[], Sequence[_Entry | _Modules | PlainNative]]
    beside: bool = False
    """Whether the second process compiles it: half of what most runs need."""
    calls_system: bool = False
    """Whether it can be only where the system has what the loop calls."""

    def compile(self) -> None:
        """Or loads."""
        for part in self.parts():
            part.address()

    def is_kept(self) -> bool:
        """Whether all of it is there from an earlier run."""
        return all(part.is_kept() for part in self.parts())


def _loop() -> list[_Entry | PlainNative]:
    from hapsim.loop.exchange import LOOP
    from hapsim.loop.run import run_loop

    return [_Entry(run_loop, (new_record(LOOP),))]


def _port() -> list[PlainNative]:
    from hapsim.cordis import stored_energy
    from hapsim.loop import force_history, transport
    from hapsim.loop.guards import energy_guard, sign, slew, travel

    guards = [slew.shape_force, travel.fade, energy_guard.judge_energy, sign.judge]
    return [
        transport.receive_from_descriptor,
        transport.send_to_descriptor,
        force_history.keep,
        stored_energy.evaluate,
        *guards,
    ]


def _mock() -> list[_Entry | PlainNative]:
    from hapsim.device.mock.firmware import FUNCTIONS, MOCK
    from hapsim.device.mock.motion import move_gliding
    from hapsim.device.mock.serve import SERVICE, serve
    from hapsim.device.mock.wire import receive_at_once, send_at_once

    serving = _Entry(serve, (new_record(MOCK), new_record(SERVICE)))
    return [*FUNCTIONS.values(), move_gliding, receive_at_once, send_at_once, serving]


def _loopback() -> list[PlainNative]:
    from hapsim.device.mock import loopback
    from hapsim.device.mock.firmware import FUNCTIONS
    from hapsim.device.mock.motion import move_gliding

    return [*FUNCTIONS.values(), move_gliding, loopback.receive, loopback.send]


def _motion() -> list[PlainNative]:
    from hapsim.device.mock.motion import move_free, move_on_spring

    return [move_free, move_on_spring]


def _wire() -> list[PlainNative]:
    from hapsim.device.mock.firmware import take_late_force
    from hapsim.device.mock.wire import receive_in_time, send_in_time

    return [take_late_force, receive_in_time, send_in_time]


def _changes() -> list[_Entry | PlainNative]:
    import numpy as np

    from hapsim.cordis import parameters
    from hapsim.loop import crossfade

    return [
        parameters.move,
        crossfade.cross_fade,
        _Entry(parameters.post, (new_record(parameters.PARAMETERS), np.zeros(0), 1)),
        _Entry(crossfade.post, (new_record(crossfade.SCENE_SLOT), 0, 1, 0)),
    ]


def _portable() -> list[_Entry]:
    from hapsim.loop import portable
    from hapsim.loop.exchange import LOOP

    return [_Entry(*entry) for entry in portable.entries_for(new_record(LOOP))]


UNITS: dict[str, Unit] = {
    "loop": Unit(48, _loop, calls_system=True),
    "port": Unit(15, _port, calls_system=True),
    "mock": Unit(45, _mock, beside=True, calls_system=True),
    "loopback": Unit(39, _loopback, beside=True),
    "motion": Unit(12, _motion, beside=True),
    "wire": Unit(14, _wire, beside=True, calls_system=True),
    "changes": Unit(8, _changes),
    "portable": Unit(40, _portable, beside=True),
    "modules": Unit(130, lambda: [_Modules("double")]),
    "modules in single precision": Unit(124, lambda: [_Modules("single")], beside=True),
}
"""What there is to compile ahead, by name."""


def compile_ahead(names: Iterable[str], counted: Counted, then: Callable[[], None] = lambda: None) -> None:
    """Compiles these units, or loads them; `counted` hears of what is compiled beside, and what to expect. `then`: more
    to be compiled here, before the process beside is waited for."""
    missing = [name for name in names if not UNITS[name].is_kept()]
    counted.expect(sum(UNITS[name].functions for name in missing))
    beside = [name for name in missing if UNITS[name].beside]
    with _beside(beside if len(beside) < len(missing) else [], counted.add) as finished:
        for name in missing:
            if not UNITS[name].beside:
                UNITS[name].compile()
        then()
        finished()
        for name in names:
            UNITS[name].compile()


@contextlib.contextmanager
def _beside(names: Sequence[str], heard: Callable[[str], None]) -> Iterator[Callable[[], None]]:
    """Compiles units in a process of its own while open, where there is a second processor; what is given waits for
    it. Should it fail, nothing is lost: whoever needs the units compiles them."""
    process = _start_compiling(names) if names and (os.cpu_count() or 1) > 1 else None
    if process is None:
        yield lambda: None
        return
    with process:

        def listen() -> None:
            for line in process.stdout or ():
                heard(line.strip())

        listener = threading.Thread(target=listen, name="compiling beside")
        listener.start()
        try:
            yield listener.join
        finally:
            process.terminate()
            listener.join()


def _start_compiling(names: Sequence[str]) -> subprocess.Popen[str] | None:
    """The process; None where Python cannot be started a second time, as when it stands inside another program."""
    # What stands beside a user's scenes is no module of ours: -P keeps it out, and the paths are this process's own.
    command = [sys.executable or "", "-P", "-m", "hapsim.running.compile_ahead", *names]
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(path for path in sys.path if path)}
    streams: dict[str, Any] = {"stdin": subprocess.DEVNULL, "stdout": subprocess.PIPE, "stderr": subprocess.DEVNULL}
    try:
        return subprocess.Popen(command, text=True, env=environment, **streams)
    except OSError:
        return None


def main(names: list[str]) -> None:
    """The process beside."""
    with on_compilation(lambda name: print(name, flush=True)):
        for name in names:
            UNITS[name].compile()


if __name__ == "__main__":
    main(sys.argv[1:])
