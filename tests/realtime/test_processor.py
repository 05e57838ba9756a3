"""One processor for the loop: which one, who has to leave it, and everybody back afterwards."""

from __future__ import annotations

import errno
import os
from collections.abc import Callable
from pathlib import Path

import pytest

from hapsim.loop import realtime as processor
from hapsim.loop.realtime import pin_to_cpu
from hapsim.system_files import SystemFiles

LOOP, MAIN, OTHER = 11, 22, 33


class Machine:
    """A system with three threads of this process; a thread's affinity may be set to what is in `possible`."""

    def __init__(self, possible: set[int], directory: Path) -> None:
        self.possible = possible
        self.affinity = everybody(*possible)
        self.isolated, self.threads = directory / "sys/devices/system/cpu/isolated", directory / "task"
        self.isolated.parent.mkdir(parents=True)
        self.isolated.write_text("\n", encoding="utf-8")
        for thread in self.affinity:
            (self.threads / str(thread)).mkdir(parents=True)

    def get(self, thread: int) -> set[int]:
        if thread not in self.affinity:
            raise ProcessLookupError(errno.ESRCH, os.strerror(errno.ESRCH))
        return set(self.affinity[thread])

    def set(self, thread: int, cpus: set[int]) -> None:
        self.get(thread)
        if not cpus & self.possible:
            raise OSError(errno.EINVAL, os.strerror(errno.EINVAL))
        self.affinity[thread] = cpus & self.possible


def everybody(*cpus: int) -> dict[int, set[int]]:
    """The affinity of each thread where it is the same for all."""
    return {thread: set(cpus) for thread in (LOOP, MAIN, OTHER)}


@pytest.fixture
def machine(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Machine:
    """Four processors, none isolated."""
    made = Machine({0, 1, 2, 3}, tmp_path)
    monkeypatch.setattr(processor, "SYSTEM", SystemFiles(tmp_path))
    monkeypatch.setattr(processor, "_THREADS", made.threads)
    monkeypatch.setattr(os, "sched_getaffinity", made.get)
    monkeypatch.setattr(os, "sched_setaffinity", made.set)
    return made


def test_the_thread_has_one_processor_while_it_lasts_and_all_it_had_afterwards(thread_id: int) -> None:
    before, mine = os.sched_getaffinity(thread_id), os.sched_getaffinity(0)
    with pin_to_cpu(thread_id) as grant:
        inside, mine_inside = os.sched_getaffinity(thread_id), os.sched_getaffinity(0)
    assert grant.granted is (len(inside) == 1)
    if grant.granted and len(mine) > 1:
        assert mine_inside == mine - inside
    assert (os.sched_getaffinity(thread_id), os.sched_getaffinity(0)) == (before, mine)


ALL = {0, 1, 2, 3}
CASES: dict[str, tuple[str | None, list[set[int]], list[set[int]], str]] = {
    "the last allowed": ("\n", [ALL] * 3, [{3}, {0, 1, 2}, {0, 1, 2}], "CPU 3; 2 other threads moved off it"),
    "nothing says what is isolated": (None, [ALL] * 3, [{3}, {0, 1, 2}, {0, 1, 2}], "CPU 3; 2 other"),
    "nonsense": ("none of them\n", [ALL] * 3, [{3}, {0, 1, 2}, {0, 1, 2}], "CPU 3; 2 other"),
    "isolated": ("1-2\n", [{0, 3}] * 3, [{2}, {0, 3}, {0, 3}], "CPU 2, isolated from the scheduler"),
    "isolated and allowed": ("1,3\n", [{0, 1}, {0}, {0}], [{1}, {0}, {0}], "CPU 1, isolated from the scheduler"),
    "one of them is not there": ("2,7\n", [ALL] * 3, [{2}, {0, 1, 3}, {0, 1, 3}], "CPU 2, isolated from the"),
    "none of them is there": ("6-7\n", [ALL] * 3, [{3}, {0, 1, 2}, {0, 1, 2}], "CPU 3; 2 other"),
    "one allowed": ("\n", [{1}] * 3, [{1}] * 3, "CPU 1, the only one allowed: there was nothing to choose"),
    "others have places of their own": ("\n", [ALL, {3}, {0, 1}], [{3}, {3}, {0, 1}], "CPU 3"),
}
"""Isolated CPUs; CPUs of the loop, main and another thread before and during the run; the printed sentence."""


@pytest.mark.parametrize("case", CASES)
def test_which_processor_it_is_and_who_leaves_it(case: str, machine: Machine) -> None:
    isolated, before, inside, detail = CASES[case]
    if isolated is None:
        machine.isolated.unlink()
    else:
        machine.isolated.write_text(isolated, encoding="utf-8")
    machine.affinity = dict(zip((LOOP, MAIN, OTHER), before, strict=True))
    with pin_to_cpu(LOOP) as grant:
        assert list(machine.affinity.values()) == inside
    assert grant.granted
    assert grant.detail.startswith(detail)
    assert list(machine.affinity.values()) == before


def test_a_thread_that_ends_in_between_does_not_keep_the_others_from_their_places(machine: Machine) -> None:
    with pin_to_cpu(LOOP):
        del machine.affinity[MAIN]
    assert machine.affinity == {LOOP: {0, 1, 2, 3}, OTHER: {0, 1, 2, 3}}


def test_a_thread_that_ended_before_it_was_moved_is_passed_over(machine: Machine) -> None:
    del machine.affinity[MAIN]
    with pin_to_cpu(LOOP) as grant:
        assert machine.affinity == {LOOP: {3}, OTHER: {0, 1, 2}}
    assert grant.detail == "CPU 3; 1 other thread moved off it"


def test_without_a_list_of_threads_the_loop_has_its_processor(
    machine: Machine, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(processor, "_THREADS", machine.threads / "nowhere")
    with pin_to_cpu(LOOP) as grant:
        assert machine.affinity == {LOOP: {3}, MAIN: {0, 1, 2, 3}, OTHER: {0, 1, 2, 3}}
    assert grant.granted


@pytest.mark.usefixtures("machine")
def test_who_is_refused_reads_what_to_do(refuse: Callable[[str, int], None]) -> None:
    refuse("os.sched_setaffinity", errno.EPERM)
    with pin_to_cpu(LOOP) as grant:
        pass
    assert not grant.granted
    assert os.strerror(errno.EPERM) in grant.detail
    assert "taskset" in grant.detail
