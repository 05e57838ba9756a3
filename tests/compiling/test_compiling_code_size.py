"""A function's instructions to the compiler change no result."""

from __future__ import annotations

import numpy as np

from firmware_protocol.compiled import ONE, compact
from hapsim.compiling import entry, fence, helper, inlined


def add_up(numbers):
    compact()
    total = 0.0
    for i in range(numbers.size):
        fence()
        total += numbers[i]
    return total


@helper
def add_up_elsewhere(numbers):
    compact()
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
