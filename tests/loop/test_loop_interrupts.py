"""An interrupt during a compilation is kept until it does no harm."""

from __future__ import annotations

import os
import signal

import numba
import pytest

from hapsim.compiled import on_compilation


def test_an_interrupt_during_a_compilation_comes_when_it_is_over() -> None:
    told = []

    def interrupt(name: str) -> None:
        told.append(name)
        os.kill(os.getpid(), signal.SIGINT)
        told.append("went on")  # the interrupt did not break in here

    function = numba.njit(lambda x: x + 1)
    before = signal.getsignal(signal.SIGINT)
    with pytest.raises(KeyboardInterrupt), on_compilation(interrupt):
        function(1)
    assert told == ["<lambda>", "went on"]
    assert signal.getsignal(signal.SIGINT) == before
    assert function(1) == 2


def test_the_next_function_is_not_begun() -> None:
    told = []

    def interrupt(name: str) -> None:
        told.append(name)
        os.kill(os.getpid(), signal.SIGINT)

    @numba.njit
    def inner(x: int) -> int:
        return x + 1

    @numba.njit
    def outer(x: int) -> int:
        return int(inner(x))

    with pytest.raises(KeyboardInterrupt), on_compilation(interrupt):
        outer(1)
    assert told == ["outer"]
