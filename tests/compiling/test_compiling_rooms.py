"""Everything that is compiled stands where the code cache looks for changes; so does all that it is made of."""

from __future__ import annotations

import ast
import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import firmware_protocol
from firmware_protocol import code_cache
from hapsim.compiling import COMPILED_ROOMS

PROTOCOL = Path(firmware_protocol.__file__).resolve().parent
HAPSIM = PROTOCOL.parent / "hapsim"


def is_in(file: Path, rooms: tuple[Path, ...]) -> bool:
    return any(file.is_relative_to(room) for room in rooms)


def sources_of(file: Path) -> set[Path]:
    """What the machine code of a file's functions is kept under: firmware_protocol compiles from itself alone."""
    return set(code_cache.sources_of([file], (PROTOCOL,) if is_in(file, (PROTOCOL,)) else COMPILED_ROOMS))


def test_what_is_looked_for_is_found(every_compiled: list[Any]) -> None:
    """Else the tests below would hold of nothing."""
    found = {(one.kind, one.file.name, one.name) for one in every_compiled}
    assert {
        ("entry", "run.py", "run_loop"),
        ("entry", "serve.py", "serve"),
        ("native", "linear_links.py", "add_forces"),
        ("native", "crossfade.py", "cross_fade"),
        ("piece", "encoding.py", "crc_of"),
        ("piece", "structure.py", "moved"),
        ("overload", "structure.py", "_choose_update"),
        ("overload", "system.py", "_compiled_now_ns"),
        ("intrinsic", "native.py", "value_of"),
        ("lowering", "compiled.py", "emits.<locals>.decorate.<locals>.lower"),
    } <= found
    (run_loop,) = (one for one in every_compiled if one.name == "run_loop")
    assert {PROTOCOL / "encoding.py", HAPSIM / "cordis" / "tick.py", HAPSIM / "loop" / "system.py"} <= run_loop.reached


def test_no_compiled_function_of_the_packages_stands_outside_the_rooms(every_compiled: list[Any]) -> None:
    ours = [one for one in every_compiled if is_in(one.file, (HAPSIM, PROTOCOL))]
    assert [str(one) for one in ours if not is_in(one.file, COMPILED_ROOMS)] == []


def test_no_machine_code_is_made_of_what_the_cache_does_not_look_at(every_compiled: list[Any]) -> None:
    """Not the benches' either, whose functions stand outside the rooms: each in the file that is looked at with it."""
    roots = [one for one in every_compiled if one.kind in ("entry", "native")]
    assert [f"{one}: {file}" for one in roots for file in sorted(one.reached - sources_of(one.file))] == []


def imports_of(source: Path) -> set[Path]:
    """The files of our packages that a source imports, by Python's own grammar."""
    names: set[str] = set()
    for node in ast.walk(ast.parse(source.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{source}: a relative import, which the cache does not look for"
            names |= {node.module or ""} | {f"{node.module}.{alias.name}" for alias in node.names}
    files = set()
    for name in names:
        parts = name.split(".")
        if parts[0] in (HAPSIM.name, PROTOCOL.name):
            packages = [HAPSIM.parent.joinpath(*parts[:i], "__init__.py") for i in range(1, len(parts) + 1)]
            files |= {*packages, HAPSIM.parent.joinpath(*parts).with_suffix(".py")}
    return {file for file in files if file.is_file()}


def test_the_cache_sees_every_import_of_a_source(every_compiled: list[Any]) -> None:
    """It looks for them in the text, without Python's grammar."""
    sources = {file for room in COMPILED_ROOMS for file in room.rglob("*.py")} | {one.file for one in every_compiled}
    assert len(sources) > 80
    for source in sources:
        assert set(code_cache._imports_of(source)) == imports_of(source), source


COMPILE = """
import json, sys
from numba.core import event
from firmware_protocol.decoder import frames_in, new_decoder
from firmware_protocol.frames import SETUP
from hapsim.compiling.native import NativeFunction
from hapsim.cordis.program import compile_scene
from hapsim.scene import Scene

at_hand, found = [], set()

class Listener(event.Listener):
    def on_start(self, event):
        at_hand.append(event.data["dispatcher"].py_func.__code__.co_filename)
        found.add((at_hand[0], at_hand[-1]))
    def on_end(self, event):
        at_hand.pop()

compile_native = NativeFunction._compile

def compile_noted(self, signature):
    at_hand.append(self.function.__code__.co_filename)
    found.add((at_hand[0], at_hand[-1]))
    try:
        return compile_native(self, signature)
    finally:
        at_hand.pop()

NativeFunction._compile = compile_noted
with event.install_listener("numba:compile", Listener()):
    program = compile_scene(Scene.model_validate(json.loads(sys.argv[1])))
    list(frames_in(new_decoder(SETUP, to_device=True), bytes(4)))
print(json.dumps(sorted(found)))
"""
VALUES = {"mass": 0.01, "stiffness": 100.0}
LINK = {"between": ["ball", "hand"]}
MODULES = {
    "hand": {"type": "device", "channel": 0},
    "wall": {"type": "ground"},
    "ball": {"type": "mass", "mass": 0.1},
    "cell": {"type": "cell", **VALUES},
    "string": {"type": "string", "masses": 5, **VALUES},
    "stiff_string": {"type": "string", "masses": 5, "bending": 9.0, **VALUES},
    "membrane": {"type": "membrane", "rows": 2, "columns": 3, **VALUES},
    "sensed": {"type": "viscoelastic", "stiffness": 9.0, "damper": "sensed", **LINK},
    "buffer": {"type": "buffer", "stiffness": 9.0, **LINK},
    "nonlinear": {"type": "nonlinear", "force_over_distance": [[-0.1, -1.0], [0.1, 1.0]], **LINK},
    "friction": {"type": "friction", "force": 1.0, "stiffness": 9.0, **LINK},
    "plectrum": {"type": "plectrum", "stiffness": 9.0, "release": 0.1, **LINK},
}


def test_all_that_numba_compiles_for_a_function_is_looked_at(tmp_path: Path) -> None:
    """What is chosen by type, as the steps of a stencil are, is only known once it is compiled: with nothing kept."""
    scene = {"version": 1, "rate": 1000, "device": {"mass": 0.2}, "modules": MODULES}
    environment = os.environ | {"XDG_CACHE_HOME": str(tmp_path)}
    command = [sys.executable, "-c", COMPILE, json.dumps(scene)]
    done = subprocess.run(command, capture_output=True, text=True, check=True, env=environment)
    found = [(Path(root).resolve(), Path(file).resolve()) for root, file in json.loads(done.stdout)]
    ours = [(root, file) for root, file in found if is_in(file, (HAPSIM, PROTOCOL))]
    names = {(root.stem, file.stem) for root, file in ours}
    assert {
        ("string", "structure"),
        ("membrane", "structure"),
        ("nonlinear_links", "link"),
        ("decoder", "encoding"),
    } <= names
    assert [(root, file) for root, file in ours if file not in sources_of(root)] == []
