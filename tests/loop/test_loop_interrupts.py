"""An interrupt during a compilation is kept until it does no harm."""

from __future__ import annotations

import os
import signal
from collections.abc import Iterator
from typing import Any

import numba
import pytest

from hapsim.compiling.progress import on_compilation


@pytest.fixture
def _a_termination_interrupts() -> Iterator[None]:
    before = signal.signal(signal.SIGTERM, signal.default_int_handler)
    yield
    signal.signal(signal.SIGTERM, before)


@pytest.mark.usefixtures("_a_termination_interrupts")
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_an_interrupt_during_a_compilation_comes_when_it_is_over(number: signal.Signals) -> None:
    told = []

    def interrupt(name: str) -> None:
        told.append(name)
        os.kill(os.getpid(), number)
        told.append("went on")  # the interrupt did not break in here

    function = numba.njit(lambda x: x + 1)
    before = signal.getsignal(number)
    with pytest.raises(KeyboardInterrupt), on_compilation(interrupt):
        function(1)
    assert told == ["<lambda>", "went on"]
    assert signal.getsignal(number) == before
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

    before = signal.getsignal(signal.SIGINT)
    with pytest.raises(KeyboardInterrupt), on_compilation(interrupt):
        outer(1)
    assert told == ["outer"]
    assert signal.getsignal(signal.SIGINT) == before


def test_one_that_comes_as_soon_as_interrupts_are_kept_is_kept_too(monkeypatch: pytest.MonkeyPatch) -> None:
    set_handler, before = signal.signal, signal.getsignal(signal.SIGINT)

    def set_and_interrupt(number: int, handler: Any) -> Any:
        old = set_handler(number, handler)
        if handler != before:
            os.kill(os.getpid(), signal.SIGINT)
        return old

    function = numba.njit(lambda x: x + 1)
    told: list[str] = []
    monkeypatch.setattr(signal, "signal", set_and_interrupt)
    with pytest.raises(KeyboardInterrupt), on_compilation(told.append):
        function(1)
    assert told == ["<lambda>"]
    assert signal.getsignal(signal.SIGINT) == before
    assert function(1) == 2
