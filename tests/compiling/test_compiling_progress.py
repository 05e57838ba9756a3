"""Progress of compilations, and interrupts and garbage collection during them."""

from __future__ import annotations

import gc
import signal
import threading
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from small_functions import (
    EITHER,
    NAMES,
    NATIVE_NAME,
    add_one,
    add_to,
    anew,
    compile_entry,
    compile_native,
    reported_by,
)

from hapsim.compiling import entry
from hapsim.compiling.kept import compile_for
from hapsim.compiling.native import Behind, NativeFunction
from hapsim.compiling.progress import Counted, compiling, on_compilation

pytestmark = pytest.mark.usefixtures("cache")


@EITHER
def test_each_function_is_reported_once_and_kept_code_never(compile_it: Callable[[], Any]) -> None:
    name = NAMES[compile_it]
    told = reported_by(compile_it)
    assert told[0] == name
    assert sorted(set(told)) == sorted(told)
    assert set(told) <= {name, "add_one"}
    assert reported_by(compile_it) == []


def test_code_of_this_process_is_not_reported_again() -> None:
    function = NativeFunction(anew(add_to))
    addresses = set()

    def compile_sizes() -> None:
        addresses.update(function.call_on(Behind(np.zeros(size)), Behind(2.0))[0] for size in (1, 2, 3))

    assert reported_by(compile_sizes).count(NATIVE_NAME) == 1
    assert len(addresses) == 1


def test_a_closed_listener_receives_nothing() -> None:
    told = reported_by(lambda: None)
    compile_entry()
    assert told == []


def test_every_open_listener_receives_every_function() -> None:
    inner: list[str] = []
    outer: list[str] = []
    with on_compilation(outer.append):
        with on_compilation(inner.append):
            compile_native()
        with compiling(add_to, "another"):
            pass
    assert outer == [*inner, "another"]
    assert inner[0] == NATIVE_NAME


def test_what_two_threads_compile_at_once_leaves_interrupts_as_they_were() -> None:
    """One begins first, and ends last."""
    before = signal.getsignal(signal.SIGINT)
    begun, ended = threading.Event(), threading.Event()

    def compile_meanwhile() -> None:
        with compiling(add_to, "beside"):
            begun.set()
            ended.wait(60.0)

    with on_compilation(lambda _: None):
        with compiling(add_to, "here"):
            thread = threading.Thread(target=compile_meanwhile)
            thread.start()
            assert begun.wait(60.0)
        assert signal.getsignal(signal.SIGINT) is before
        ended.set()
        thread.join()
    assert signal.getsignal(signal.SIGINT) is before


@EITHER
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_an_interrupt_waits_until_the_compilation_is_over(
    compile_it: Callable[[], Any], number: signal.Signals
) -> None:
    """And the next function is not begun."""
    told: list[str] = []

    def interrupt(name: str) -> None:
        if not told:
            signal.raise_signal(number)
        told.append(name)  # the interrupt did not break in here

    usual = signal.signal(number, signal.default_int_handler)
    try:
        with pytest.raises(KeyboardInterrupt), on_compilation(interrupt):
            compile_it()
        assert signal.getsignal(number) is signal.default_int_handler
    finally:
        signal.signal(number, usual)
    assert len(told) == 1
    compile_it()  # the compiler is in one piece


def test_one_that_comes_as_soon_as_interrupts_are_kept_is_kept_too(monkeypatch: pytest.MonkeyPatch) -> None:
    set_handler, before = signal.signal, signal.getsignal(signal.SIGINT)

    def set_and_interrupt(number: int, handler: Any) -> Any:
        old = set_handler(number, handler)
        if handler != before:
            signal.raise_signal(signal.SIGINT)
        return old

    told: list[str] = []
    monkeypatch.setattr(signal, "signal", set_and_interrupt)
    with pytest.raises(KeyboardInterrupt), on_compilation(told.append):
        compile_entry()
    assert len(told) == 1
    assert signal.getsignal(signal.SIGINT) == before
    compile_entry()


def test_an_interrupt_in_the_last_function_leaves_it_compiled() -> None:
    def interrupt(_name: str) -> None:
        signal.raise_signal(signal.SIGINT)

    function = entry(anew(add_one))
    with pytest.raises(KeyboardInterrupt), on_compilation(interrupt):
        compile_for(function, 1)
    assert reported_by(lambda: function(1)) == []
    assert function(1) == 2


@EITHER
@pytest.mark.parametrize("is_on", [True, False])
def test_the_garbage_collector_rests_meanwhile_and_is_then_as_it_was(
    compile_it: Callable[[], Any], is_on: bool
) -> None:
    at_work: list[bool] = []
    was_on = gc.isenabled()
    (gc.enable if is_on else gc.disable)()
    try:
        with on_compilation(lambda _name: at_work.append(gc.isenabled())):
            compile_it()
        assert gc.isenabled() == is_on
    finally:
        (gc.enable if was_on else gc.disable)()
    assert at_work
    assert not any(at_work)


def test_what_fails_to_compile_leaves_interrupts_and_collector_as_they_were() -> None:
    def makes_an_array(x):
        return np.zeros(x)[0]

    before, was_on = signal.getsignal(signal.SIGINT), gc.isenabled()
    with on_compilation(lambda _name: None):
        for make in (lambda: entry(makes_an_array)(3), lambda: NativeFunction(makes_an_array).call_on(Behind(3))):
            with pytest.raises(Exception, match=r"NRT required|Failed in nopython mode"):
                make()
            assert signal.getsignal(signal.SIGINT) is before
            assert gc.isenabled() == was_on


def test_who_listens_may_fail_and_the_collector_is_on_again() -> None:
    def fail(_name: str) -> None:
        raise ValueError("not interested")

    was_on = gc.isenabled()
    with pytest.raises(ValueError, match="not interested"), on_compilation(fail):
        compile_native()
    assert gc.isenabled() == was_on
    compile_native()


def test_another_thread_compiles_without_a_hand_on_interrupts() -> None:
    """Only the main thread may set signal handlers, so compilation in another thread leaves them alone."""
    told: list[str] = []
    with on_compilation(told.append):
        thread = threading.Thread(target=compile_native)
        thread.start()
        thread.join()
    assert told[0] == NATIVE_NAME


# --- how far it is ---


def test_shares_rise_and_end_with_the_expected_number() -> None:
    heard: list[tuple[str, float | None]] = []
    counted = Counted(lambda name, share: heard.append((name, share)))
    counted.expect(3)
    counted.expect(2)
    for i in range(8):
        counted.add(f"f{i}")
    assert [name for name, _ in heard] == [f"f{i}" for i in range(8)]
    shares = [share for _, share in heard if share is not None]
    assert shares[:4] == [0.2, 0.4, 0.6, 0.8]
    assert sorted(shares) == shares
    assert len(shares) == 4


def test_without_an_expected_number_there_is_no_share() -> None:
    heard: list[float | None] = []
    counted = Counted(lambda _name, share: heard.append(share))
    counted.add("first")
    counted.expect(4)
    counted.add("second")
    assert heard == [None, 0.5]


def test_several_threads_may_count() -> None:
    heard: list[float | None] = []
    counted = Counted(lambda _name, share: heard.append(share))
    counted.expect(1000)
    threads = [threading.Thread(target=lambda: [counted.add("one") for _ in range(100)]) for _ in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert heard == [i / 1000 for i in range(1, 801)]
