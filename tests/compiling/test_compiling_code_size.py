"""A function's instructions to the compiler change no result."""

from __future__ import annotations

import numba
import numpy as np

from firmware_protocol.compiled import ONE, OPTIONS
from firmware_protocol.lean_compiler import BulkWhole, Whole
from hapsim.compiling import entry, fence, helper, inlined


def add_up(numbers):
    total = 0.0
    for i in range(numbers.size):
        fence()
        total += numbers[i]
    return total


@helper
def add_up_elsewhere(numbers):
    return add_up_inlined(numbers)


add_up_inlined = inlined(add_up)


@entry
def add_up_twice(numbers):
    return add_up_inlined(numbers) + add_up_elsewhere(numbers[ONE:])


def test_it_changes_no_result_in_plain_python_or_compiled() -> None:
    numbers = np.random.default_rng(2).normal(size=37)
    first, second = (float(np.add.accumulate(part)[-1]) for part in (numbers, numbers[1:]))  # one after the other
    assert (add_up(numbers), add_up_elsewhere(numbers)) == (first, first)
    assert add_up_twice(numbers) == first + second


def double_all(numbers):
    for i in range(numbers.size):
        numbers[i] *= 2.0


def test_loops_are_compact_and_without_vectors_unless_they_run_over_many_numbers() -> None:
    loops = {}
    for compiler in (Whole, BulkWhole):
        compiled = numba.njit(**OPTIONS | {"pipeline_class": compiler})(double_all)
        numbers = np.arange(37.0)
        compiled(numbers)
        assert np.array_equal(numbers, 2 * np.arange(37.0))
        (code,) = compiled.inspect_llvm().values()
        loops[compiler] = code.count(" fmul "), code.count(" fmul <")
    assert loops[Whole] == (1, 0) < loops[BulkWhole]
    assert loops[BulkWhole][1] > 1


@inlined
def by(numbers, factor):
    return numbers[0] * factor


@inlined
def by_two_and_three(numbers):
    return by(numbers, 2) + by(numbers, 3)


def test_a_piece_is_compiled_once_whatever_the_constants_of_its_calls() -> None:
    compiled = numba.njit(**OPTIONS)(lambda numbers: by(numbers, 5) + by_two_and_three(numbers))
    assert compiled(np.array([1.0])) == 10.0
    pieces = numba.core.registry.cpu_target.typing_context.resolve_value_type(by).dispatcher
    assert len(pieces.signatures) == 1
