"""What a function says of itself to the compiler: it changes nothing of what is worked out, compiled or not."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from firmware_protocol.compiled import ONE, compact, out_of_line
from hapsim.compiling import entry, helper, inlined
from hapsim.compiling.memory_fence import fence


def add_up(numbers):
    total = 0.0
    for i in range(numbers.size):
        total += numbers[i]
    return total


@inlined
def add_up_compactly(numbers):
    compact()
    total = 0.0
    for i in range(numbers.size):
        total += numbers[i]
    return total


@helper
def add_up_elsewhere(numbers):
    out_of_line()
    total = 0.0
    for i in range(numbers.size):
        total += numbers[i]
    return total


@inlined
def add_up_between_fences(numbers):
    fence()
    total = 0.0
    for i in range(numbers.size):
        total += numbers[i]
    fence()
    return total


@entry
def compactly(numbers):
    return add_up_compactly(numbers) + add_up_compactly(numbers[ONE:])


@entry
def elsewhere(numbers):
    return add_up_elsewhere(numbers) + add_up_elsewhere(numbers[ONE:])


@entry
def between_fences(numbers):
    return add_up_between_fences(numbers) + add_up_between_fences(numbers[ONE:])


NUMBERS = np.random.default_rng(2).normal(size=37)


@pytest.mark.parametrize("say", [compact, out_of_line, fence])
def test_in_plain_python_it_does_nothing(say: Callable[[], None]) -> None:
    assert say() is None


@pytest.mark.parametrize("function", [add_up_compactly, add_up_elsewhere, add_up_between_fences])
def test_a_function_that_says_it_is_the_same_in_plain_python(function: Callable[[np.ndarray], float]) -> None:
    assert function(NUMBERS) == add_up(NUMBERS)


@pytest.mark.parametrize("function", [compactly, elsewhere, between_fences])
def test_a_function_that_says_it_compiles_to_the_same_to_the_last_bit(
    function: Callable[[np.ndarray], float],
) -> None:
    assert function(NUMBERS) == add_up(NUMBERS) + add_up(NUMBERS[1:])
