"""The compiled tick of a scene holds nothing of what the scene does not have."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

SCENE = """
version: 1
rate: 1000
device: {mass: 0.2}
modules:
  hand: {type: device, channel: 0}
  wall: {type: ground}
  ball: {type: mass, mass: 0.1}
  touch: {type: viscoelastic, between: [hand, wall], stiffness: 2000, damping: 5}
  hold: {type: viscoelastic, between: [hand, ball], stiffness: 100}
"""
BUFFER = "  bump: {type: buffer, between: [ball, wall], stiffness: 100}\n"

# A kind of module that hapsim does not have: it would double every force.
ANOTHER_KIND = """
from typing import NamedTuple
import hapsim.cordis.kinds
from hapsim.compiled import inlined
from hapsim.cordis.acting import moves, pulls, settles
from hapsim.cordis.kind import Kind

class Doublers(NamedTuple):
    points: object

@settles(Doublers)
@pulls(Doublers)
@moves(Doublers)
@inlined
def double(part, moment):
    for p in range(moment.force.size):
        moment.force[p] += moment.force[p]

hapsim.cordis.kinds.KINDS = (Kind(lambda scene: {}, lambda *_: Doublers(None)), *hapsim.cordis.kinds.KINDS)
"""
COMPILE = """
import sys
import numpy as np
from hapsim.compiled import jit
from hapsim.cordis.program import KINDS, compile_scene
from hapsim.cordis.tick import tick
from hapsim.scene import parse_scene

program = compile_scene(parse_scene(sys.argv[1]))
tick(program, np.zeros(1), np.zeros(1), np.zeros(1))
(assembly,) = tick.inspect_asm().values()
print(len(KINDS))
print(assembly)
"""


def compiled(scene: str, cache: Path, before: str = "") -> tuple[int, list[str]]:
    """How many kinds of module there are, and the instructions of a tick, without the names that numba numbers."""
    command = [sys.executable, "-c", before + COMPILE, scene]
    done = subprocess.run(command, capture_output=True, text=True, check=True, env={"XDG_CACHE_HOME": str(cache)})
    kinds, _, assembly = done.stdout.partition("\n")
    code = assembly.split(".cfi_endproc")[0]
    lines = (line.strip() for line in code.splitlines())
    instructions = [line for line in lines if line and not line.startswith((".", "_")) and not line.endswith(":")]
    return int(kinds), [re.sub(r"_ZN\w+", "", line) for line in instructions]


@pytest.fixture(scope="module")
def as_it_is(tmp_path_factory: pytest.TempPathFactory) -> tuple[int, list[str]]:
    return compiled(SCENE, tmp_path_factory.mktemp("as_it_is"))


def test_a_kind_of_module_more_changes_no_instruction_of_a_scene_without_it(
    as_it_is: tuple[int, list[str]], tmp_path: Path
) -> None:
    kinds, instructions = as_it_is
    more_kinds, with_another = compiled(SCENE, tmp_path, ANOTHER_KIND)
    assert more_kinds == kinds + 1
    assert len(instructions) > 50
    assert with_another == instructions


def test_a_module_that_a_scene_has_is_seen_in_its_instructions(as_it_is: tuple[int, list[str]], tmp_path: Path) -> None:
    _, with_buffer = compiled(SCENE + BUFFER, tmp_path)
    assert len(with_buffer) > len(as_it_is[1]) + 10
