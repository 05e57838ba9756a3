"""What a run would compile, compiled before there is one: by a tool's set-up, or on the machine of a performance."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from hapsim.compiling.entries import directory_of_kept_code
from hapsim.compiling.progress import Counted, on_compilation
from hapsim.cordis.program import compile_scene
from hapsim.device.mock.assemble import assemble_mock
from hapsim.device.open_connection import Place, place_of_device
from hapsim.loop.system import missing_calls
from hapsim.prediction.timing import wire_of
from hapsim.progress import Progress
from hapsim.running.compile_ahead import UNITS, compile_ahead
from hapsim.scene import Scene

MOCK_UNITS: dict[Place, tuple[str, ...]] = {"port": (), "terminal": ("port", "mock"), "loopback": ("loopback",)}
"""What a device takes beside the loop, by where it is; its names are those of hapsim.running.compile_ahead."""


@dataclass(frozen=True)
class Prepared:
    """What was compiled."""

    functions: int
    seconds: float
    directory: Path | None
    """Where machine code is kept; None where nothing can be written, so that nothing was gained."""


def prepare(scenes: Sequence[Scene] = (), on_progress: Callable[[Progress], None] = lambda _: None) -> Prepared:
    """Compiles what `scenes` need to run, to be measured, and to be changed while they run; without scenes, what any
    scene could need. Afterwards nothing is compiled at their start."""
    places = {place_of_device(scene) for scene in scenes}
    names = {"loop", "port", "changes"}.union(*(MOCK_UNITS[place] for place in places)) if scenes else set(UNITS)
    if any(wire_of(scene) == "mock" for scene in scenes):
        names.add("wire")
    if missing_calls():
        names = {name for name in names if not UNITS[name].calls_system} | {"portable"}
    begun = time.monotonic()
    counted = Counted(lambda name, share: on_progress(Progress("compiling", name, share=share)))
    with on_compilation(counted.add):
        compile_ahead([name for name in UNITS if name in names], counted, lambda: _compile_scenes(scenes))
    return Prepared(counted.functions, time.monotonic() - begun, directory_of_kept_code())


def _compile_scenes(scenes: Sequence[Scene]) -> None:
    for scene in scenes:
        compile_scene(scene)
        if place_of_device(scene) != "port":
            assemble_mock(scene)  # how its bodies move
