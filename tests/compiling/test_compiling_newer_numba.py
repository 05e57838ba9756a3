"""A numba whose internal parts are others than `lean_compiler` uses: the ordinary compiler, and a line that says so."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

PROGRAM = """\
import ctypes, sys
import numba
import numpy as np
numba.version_info = numba.version_info._replace(short=(0, 99))
from numba.core import compiler_machinery, codegen
BREAK
from firmware_protocol import compiled
from firmware_protocol.compiled import entry, fma, helper, inlined, overload
from hapsim.compiling.native import native, types

@inlined
def twice(x): return 2.0 * x

@helper
def thrice(x): return twice(x) + x

@fma
def summed(values):
    total = 0.0
    for i in range(values.size): total += thrice(values[i]) * 0.5
    return total

def by_type(x): return 0.0

@overload(by_type)
def _(x): return (lambda x: 1.0) if isinstance(x, numba.types.Float) else (lambda x: 2.0)

@entry
def all_of_them(values): return summed(values) + by_type(1.0) + 10.0 * by_type(1)

@native(types.float64, types.int64, bulk=True)
def nine(count): return 9.0 + count

assert twice(1.5) == 3.0  # plain Python
assert all_of_them(np.arange(5.0)) == 15.0 + 21.0
assert nine(1) == 10.0
print(compiled._LEAN is not None)
"""


GONE = "from firmware_protocol import lean_compiler\nlean_compiler._dynfunc = None"


@pytest.mark.thorough(keep=1)
@pytest.mark.parametrize(
    ("broken", "lean", "told"),
    [
        (GONE, False, "(AttributeError: 'NoneType' object has no attribute 'make_function'"),
        ("del compiler_machinery.register_pass", False, "(ImportError: cannot import name 'register_pass' from"),
        ("", True, ""),
    ],
)
def test_functions_compile_whatever_has_become_of_numbas_parts(
    tmp_path: Path, broken: str, lean: bool, told: str
) -> None:
    path = tmp_path / "program.py"
    path.write_text(PROGRAM.replace("BREAK", broken), encoding="utf-8")
    ended = subprocess.run(
        [sys.executable, path],
        env=os.environ | {"HAPSIM_CACHE": str(tmp_path / "code"), "NUMBA_OPT": "0"},
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )
    assert (ended.returncode, ended.stdout) == (0, f"{lean}\n"), ended.stderr
    lines = ended.stderr.splitlines()
    assert len(lines) == (not lean)
    for line in lines:
        assert line.startswith("numba ")
        assert "is not one that hapsim knows, so it compiles more slowly" in line
        assert told in line
