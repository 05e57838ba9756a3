"""Two small functions to compile, an entry and a native one, and the names that are reported of it."""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from types import FunctionType
from typing import Any

import numpy as np
import pytest

from firmware_protocol import code_cache
from hapsim.compiling import entry, helper
from hapsim.compiling.kept import compile_for
from hapsim.compiling.native import Behind, NativeFunction, value_of
from hapsim.compiling.progress import on_compilation


def as_another_process() -> None:
    """Directories are looked for once more."""
    for looked_for in (code_cache.directory_for, code_cache.read_only_directories_for, code_cache._key_of):
        looked_for.cache_clear()


@helper
def add_one(x):
    return x + 1


def add_two(x):
    return add_one(x) + add_one(x) - x


def add_to(numbers, by):
    numbers, by = value_of(numbers), value_of(by)
    for i in range(numbers.size):
        numbers[i] += add_one(by) - 1


def anew(function: Any) -> Any:
    """The same function once more, as another process would find it."""
    again = FunctionType(function.__code__, function.__globals__, function.__name__)
    again.__module__, again.__qualname__ = function.__module__, function.__qualname__
    return again


def compile_entry() -> None:
    compiled = entry(anew(add_two))
    compile_for(compiled, 1)
    assert compiled(5) == 7


def compile_native() -> None:
    numbers = np.zeros(3)
    behind, by = Behind(numbers), Behind(2.0)
    address, *values = NativeFunction(anew(add_to)).call_on(behind, by)
    ctypes.CFUNCTYPE(None, ctypes.c_uint64, ctypes.c_uint64)(address)(*values)
    assert numbers.tolist() == [2.0] * 3


NATIVE_NAME = f"{__name__.rpartition('.')[2]}.add_to"
NAMES = {compile_entry: "add_two", compile_native: NATIVE_NAME}
EITHER = pytest.mark.parametrize("compile_it", NAMES)


def reported_by(compile_it: Callable[[], Any]) -> list[str]:
    """The functions whose compilation is reported."""
    told: list[str] = []
    with on_compilation(told.append):
        compile_it()
    return told
