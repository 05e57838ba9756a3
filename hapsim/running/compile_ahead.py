"""Compiling before a run needs the code: in `start`, and by `hapsim compile`. A second process takes half of it.

A run needs the loop, the module types of its scene and, with a mock in this process, the mock.
`python -m hapsim.running.compile_ahead mock` is the second process. It prints the name of each function as its
compilation begins, and keeps the machine code where the first process finds it.
"""

from __future__ import annotations

import contextlib
import os
import pkgutil
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import cycle, product
from pathlib import Path
from string import Template
from typing import TYPE_CHECKING, Any, NamedTuple, get_args

import numpy as np

from firmware_protocol.compiled import new_record
from firmware_protocol.decoder import DECODER
from hapsim.compiling.kept import compile_for, directory_of_kept_code, is_kept, why_not_kept
from hapsim.compiling.native import PlainNative
from hapsim.compiling.progress import Counted, on_compilation
from hapsim.loop.counts import Progress
from hapsim.loop.system import missing_calls

if TYPE_CHECKING:
    from hapsim.device.open_connection import Place
    from hapsim.scene import Scene


_EVERY_MODULE = Path(__file__).with_name("every_module.yaml")
_EVERY_PLANE_MODULE = Path(__file__).with_name("every_plane_module.yaml")
_OF_CORDIS = """  cup: {type: proxy, mass: 1, hand: hand, stiffness: 1}
  gate: {type: spring, between: [hand, wall], stiffness: 1, when: touch}
  other: {type: device, channel: 1}
  tie: {type: viscoelastic, between: [hand, other], stiffness: 1, gain: {force: 1}}
inputs: {touch: {bit: 0}}
"""  # under no other scheme


class CompileUnit(NamedTuple):
    """Functions that are compiled together, named and not imported, because numba loads slowly."""

    functions: int
    """Estimated number of functions, for the progress display."""
    natives: tuple[str, ...] = ()
    """Native functions, or dicts of them, as module:name below hapsim."""
    entries: Callable[[], Iterable[tuple[Any, ...]]] = tuple
    """Function that returns entries, each with arguments of the types to compile for."""
    modules: str = ""
    """Precision in which every module type is compiled for every scheme; "" for none."""
    in_second_process: bool = False
    """True if the second process compiles it: half of the code of most runs."""
    calls_system: bool = False
    """True if it needs the system calls of the loop."""

    def compile(self) -> None:
        """Compiles or loads all functions."""
        for native in self._resolved():
            native.address()
        for function, *arguments in self.entries():
            compile_for(function, *arguments)
        if self.modules:
            _compile_modules(self.modules)

    def is_kept(self) -> bool:
        """Returns whether an earlier run left all machine code; False for modules: a check is slower than loading."""
        return (
            not self.modules
            and all(native.is_kept() for native in self._resolved())
            and all(is_kept(*entry) for entry in self.entries())
        )

    def _resolved(self) -> Iterator[PlainNative]:
        for name in self.natives:
            found = pkgutil.resolve_name(f"hapsim.{name}")
            yield from found.values() if isinstance(found, dict) else (found,)


def _entry(function: str, *arguments: Any) -> Callable[[], list[tuple[Any, ...]]]:
    """Returns a function that finds an entry below hapsim by name, with its arguments; a dtype means a record."""

    def resolved(one: Any) -> Any:
        found = pkgutil.resolve_name(f"hapsim.{one}") if isinstance(one, str) else one
        return new_record(found) if isinstance(found, np.dtype) else found

    return lambda: [tuple(map(resolved, (function, *arguments)))]


def _portable_loop() -> list[tuple[Any, ...]]:
    from hapsim.loop.exchange import LOOP
    from hapsim.loop.portable import entries_for

    return entries_for(new_record(LOOP))


def _compile_modules(precision: str) -> None:
    from hapsim.cordis.program import compile_scene
    from hapsim.cordis.succession import take_over_from

    for scene in scenes_with_every_module(precision):
        program, following = compile_scene(scene), compile_scene(scene)
        take_over_from(program, scene, following, scene)


_FIRMWARE = ("device.mock.firmware:FUNCTIONS", "device.mock.motion:move_gliding")

UNITS: dict[str, CompileUnit] = {
    "loop": CompileUnit(
        69,
        ("loop.guards.leap:find_leap",),
        _entry("loop.compiled_loop:run_loop", "loop.exchange:LOOP"),
        calls_system=True,
    ),
    "ports": CompileUnit(
        72,
        ("loop.joint_loop:release",),
        _entry("loop.joint_loop:run_loops", "loop.joint_loop:JOINT"),
        calls_system=True,
    ),
    "port": CompileUnit(
        6, ("loop.transport:receive_from_descriptor", "loop.transport:send_to_descriptor"), calls_system=True
    ),
    "guards": CompileUnit(  # a run compiles only those that its scene sets up
        59,
        (
            "loop.guards:HOOKS",
            "loop.force_history:keep",
            "loop.guide:lead",
            "loop.output_words:compose_outputs",
            "cordis.stored_energy:evaluate",
        ),
    ),
    "lines": CompileUnit(13, tuple(f"loop.board_law:{act}_lines" for act in ("find", "begin", "write", "keep"))),
    "mock": CompileUnit(
        54,
        (*_FIRMWARE, "device.mock.wire:receive_at_once", "device.mock.wire:send_at_once"),
        _entry("device.mock.terminal:serve", "device.mock.record:MOCK", "device.mock.terminal:SERVICE"),
        in_second_process=True,
        calls_system=True,
    ),
    "loopback": CompileUnit(
        41,
        (*_FIRMWARE, "device.mock.wire:receive_in_memory", "device.mock.wire:send_in_memory"),
        in_second_process=True,
    ),
    "motion": CompileUnit(
        10,
        ("device.mock.motion:move_with_spring_or_friction", "device.mock.stand_ins:move_hand"),
        in_second_process=True,
    ),
    "coupled": CompileUnit(7, ("device.mock.firmware:advance_coupled",), in_second_process=True),
    "drive": CompileUnit(22, ("device.mock.firmware:advance_driven",), in_second_process=True),
    "following": CompileUnit(12, ("device.mock.line_follower:FUNCTIONS",), in_second_process=True),
    "wire": CompileUnit(
        20,
        ("device.mock.firmware:take_late_force", "device.mock.wire:receive_in_time", "device.mock.wire:send_in_time"),
        in_second_process=True,
        calls_system=True,
    ),
    "sound": CompileUnit(2, ("loop.sound:add_frame",)),
    "playback": CompileUnit(11, ("sound.resample:play",), calls_system=True),
    "changes": CompileUnit(
        18,
        (
            "cordis.parameters:move",
            "loop.crossfade:cross_fade",
            "loop.posted:copy_blocks",
            "loop.pulse:add_pulses",
            "loop.pulse:spend_on_pulses",
        ),
    ),
    "replay": CompileUnit(
        51,
        entries=_entry(
            "loop.compiled_loop:replay_rows", "loop.exchange:LOOP", DECODER, np.zeros((0, 1), np.int64), True, True
        ),
        in_second_process=True,
    ),
    "measuring": CompileUnit(
        1,
        entries=_entry("measuring.regression:slow", *(np.ones((1,) * n, t) for n, t in ((2, "d"), (1, "D"), (3, "D")))),
    ),
    "portable": CompileUnit(40, entries=_portable_loop, in_second_process=True),
    "modules": CompileUnit(144, modules="double"),
    "modules in single precision": CompileUnit(149, modules="single", in_second_process=True),
}
"""Units that can be compiled ahead, by name."""

DEVICE_UNITS: dict[Place, tuple[str, ...]] = {
    "port": ("port",),
    "terminal": ("port", "mock"),
    "loopback": ("loopback",),
}
"""Units that a device needs in addition to the loop, by its place."""


def compile_ahead(names: Iterable[str], counted: Counted, then: Callable[[], None] = lambda: None) -> None:
    """Compiles or loads these units. `counted` counts both processes. `then` compiles more in this process, before the
    wait for the second one. Units that this process has loaded before cost nothing."""
    names = [name for name in names if name not in _loaded]
    missing = [name for name in names if not UNITS[name].is_kept()]
    counted.expect(sum(UNITS[name].functions for name in missing))
    # The second process can only pass code on by keeping it on disk.
    second = [name for name in missing if UNITS[name].in_second_process and directory_of_kept_code()]
    with _second_process(second if len(second) < len(missing) else [], counted.add) as wait:
        for name in missing:
            if not UNITS[name].in_second_process:
                UNITS[name].compile()
        then()
        wait()
        for name in names:
            UNITS[name].compile()
    _loaded.update(names)


_loaded: set[str] = set()


@contextlib.contextmanager
def _second_process(names: Sequence[str], on_line: Callable[[str], None]) -> Iterator[Callable[[], None]]:
    """Compiles units in another process while open, if there is a second processor. Yields a function that waits for
    it. If it fails, this process compiles the units."""
    process = _start_compiling(names) if names and (os.cpu_count() or 1) > 1 else None
    if process is None:
        yield lambda: None
        return

    def listen(lines: Iterable[str]) -> None:
        for line in lines:
            on_line(line.strip())

    with process:
        listener = threading.Thread(target=listen, args=(process.stdout,), name="second process")
        listener.start()
        try:
            yield listener.join
        finally:
            process.terminate()
            listener.join()


def _start_compiling(names: Sequence[str]) -> subprocess.Popen[str] | None:
    """Returns the process; None if Python cannot be started again, as when another program embeds it."""
    # With -P, no file beside a user's scenes is imported as one of hapsim. The paths are this process's own.
    command = [sys.executable or "", "-P", "-m", "hapsim.running.compile_ahead", *names]
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(path for path in sys.path if path)}
    streams: dict[str, Any] = {"stdin": subprocess.DEVNULL, "stdout": subprocess.PIPE, "stderr": subprocess.DEVNULL}
    try:
        return subprocess.Popen(command, text=True, env=environment, **streams)
    except OSError:
        return None


def main(names: list[str]) -> None:
    """Compiles these units, as the second process."""
    with on_compilation(lambda name: print(name, flush=True)):
        for name in names:
            UNITS[name].compile()


@dataclass(frozen=True)
class Prepared:
    """The result of `prepare`."""

    functions: int
    seconds: float
    directory: Path | None
    """Directory of the machine code; None if it is not kept."""
    problem: str = ""
    """Reason why it is not kept."""


def prepare(scenes: Sequence[Scene] = (), on_progress: Callable[[Progress], None] = lambda _: None) -> Prepared:
    """Compiles the code that `scenes` need to run, to be measured and changed; without scenes, all code."""
    from hapsim.device.open_connection import place_of_device
    from hapsim.prediction.timing import wire_of

    joint = {"ports"} if any(scene.ports for scene in scenes) else set[str]()
    scenes = [one for scene in scenes for one in ([scene.at_port(port) for port in scene.ports] or [scene])]
    places = {place_of_device(scene) for scene in scenes}
    names = joint.union({"loop", "port", "guards", "changes", "measuring"}, *(DEVICE_UNITS[place] for place in places))
    if places - {"port"}:
        names |= {"motion", "loopback"}  # a mock that is served is in memory
    if any(scene.mock_device.mass_matrix for scene in scenes):
        names.add("coupled")
    if any(scene.device.law == "board" for scene in scenes):
        names |= {"lines", "following"} if places - {"port"} else {"lines"}
    if any(scene.sound for scene in scenes):
        names |= {"sound", "playback"}
    if any(wire_of(scene) == "mock" for scene in scenes):
        names.add("wire")
    if not scenes:
        names = set(UNITS)
    if missing_calls():
        names = {name for name in names if not UNITS[name].calls_system} | {"portable"}
    begun = time.monotonic()
    counted = Counted(lambda name, share: on_progress(Progress("compiling", name, share=share)))
    with on_compilation(counted.add):
        compile_ahead(sorted(names, key=[*UNITS].index), counted, lambda: _compile_scenes(scenes))
    problem = why_not_kept() if counted.functions else ""
    directory = None if problem else directory_of_kept_code(found=not counted.functions)
    return Prepared(counted.functions, time.monotonic() - begun, directory, problem)


def _compile_scenes(scenes: Sequence[Scene]) -> None:
    from hapsim.cordis.program import compile_scene
    from hapsim.device.mock.assemble_mock import assemble_mock
    from hapsim.device.open_connection import place_of_device

    for scene in scenes:
        compile_scene(scene)
        if place_of_device(scene) != "port":
            assemble_mock(scene)  # the motion of its bodies


def scenes_with_every_module(precision: str) -> Iterator[Scene]:
    """Yields two scenes with every module type of a line for each scheme, then one with those of the plane. In one of
    the two damping couples the modes, so that the exact scheme uses one matrix."""
    from hapsim.scene import DamperScheme, SchemeName, parse_scene
    from hapsim.scene.choices import WITH_CUTOFF

    template = _EVERY_MODULE.read_text(encoding="utf-8")  # and links to a point of each kind
    for damper, held in zip(get_args(DamperScheme), cycle(("ball", "gut.0", "bar.0", "skin.0.0")), strict=False):
        cutoff = ", cutoff: 10" if damper in WITH_CUTOFF else ""
        ends = f"between: [hand, {held}], stiffness: 1, damper: {damper}{cutoff}"
        template += f"  {damper}: {{type: viscoelastic, {ends}}}\n"
    for scheme, damping in product(get_args(SchemeName), (0, 1)):
        text = Template(template).substitute(precision=precision, scheme=scheme, damping=damping)
        yield parse_scene(text + _OF_CORDIS if scheme == "cordis" else text, "every module")
    plane = Template(_EVERY_PLANE_MODULE.read_text(encoding="utf-8")).substitute(precision=precision)
    yield parse_scene(plane, "every module of the plane")


if __name__ == "__main__":
    main(sys.argv[1:])
