"""One processor for the loop: which one, who has to leave it, and everybody back afterwards."""

from __future__ import annotations

import errno
import os
from collections.abc import Callable
from pathlib import Path

import pytest

from hapsim.loop.realtime import scheduling as processor
from hapsim.loop.realtime.scheduling import pinned

LOOP, MAIN, OTHER = 11, 22, 33


class Machine:
    """A system with three threads of this process; a thread's affinity may be set to what is in `possible`."""

    def __init__(self, possible: set[int], directory: Path) -> None:
        self.possible = possible
        self.affinity = everybody(*possible)
        self.isolated, self.threads = directory / "isolated", directory / "task"
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
    monkeypatch.setattr(processor, "_ISOLATED", made.isolated)
    monkeypatch.setattr(processor, "_THREADS", made.threads)
    monkeypatch.setattr(os, "sched_getaffinity", made.get)
    monkeypatch.setattr(os, "sched_setaffinity", made.set)
    return made


def test_the_thread_has_one_processor_while_it_lasts_and_all_it_had_afterwards(thread_id: int) -> None:
    before, mine = os.sched_getaffinity(thread_id), os.sched_getaffinity(0)
    with pinned(thread_id) as grant:
        inside, mine_inside = os.sched_getaffinity(thread_id), os.sched_getaffinity(0)
    assert grant.granted is (len(inside) == 1)
    if grant.granted and len(mine) > 1:
        assert mine_inside == mine - inside
    assert (os.sched_getaffinity(thread_id), os.sched_getaffinity(0)) == (before, mine)


def test_without_an_isolated_one_it_is_the_last_allowed_and_the_others_leave_it(machine: Machine) -> None:
    with pinned(LOOP) as grant:
        assert machine.affinity == {LOOP: {3}, MAIN: {0, 1, 2}, OTHER: {0, 1, 2}}
    assert (grant.granted, grant.detail) == (True, "CPU 3; 2 other threads moved off it")
    assert machine.affinity == everybody(0, 1, 2, 3)


def test_an_isolated_one_is_preferred_though_it_is_not_among_the_allowed(machine: Machine) -> None:
    machine.isolated.write_text("1-2\n", encoding="utf-8")
    machine.affinity = everybody(0, 3)
    with pinned(LOOP) as grant:
        assert machine.affinity == {LOOP: {2}, MAIN: {0, 3}, OTHER: {0, 3}}
    assert (grant.granted, grant.detail) == (True, "CPU 2, isolated from the scheduler")
    assert machine.affinity == everybody(0, 3)


def test_of_isolated_ones_an_allowed_one_is_preferred(machine: Machine) -> None:
    machine.isolated.write_text("1,3\n", encoding="utf-8")
    machine.affinity[LOOP] = {0, 1}
    with pinned(LOOP):
        assert machine.affinity[LOOP] == {1}


def test_an_isolated_one_that_cannot_be_had_is_passed_over(machine: Machine) -> None:
    machine.isolated.write_text("2,7\n", encoding="utf-8")
    with pinned(LOOP) as grant:
        assert machine.affinity[LOOP] == {2}
    machine.isolated.write_text("6-7\n", encoding="utf-8")
    with pinned(LOOP) as grant:
        assert machine.affinity[LOOP] == {3}
    assert "isolated" not in grant.detail


@pytest.mark.parametrize("text", [None, "", "none of them\n"])
def test_a_system_that_does_not_tell_what_is_isolated_has_nothing_isolated(text: str | None, machine: Machine) -> None:
    machine.isolated.unlink()
    if text is not None:
        machine.isolated.write_text(text, encoding="utf-8")
    with pinned(LOOP):
        assert machine.affinity[LOOP] == {3}


def test_where_one_is_allowed_there_is_nothing_to_choose_and_nobody_moves(machine: Machine) -> None:
    machine.affinity = everybody(1)
    with pinned(LOOP) as grant:
        assert machine.affinity == everybody(1)
    assert (grant.granted, grant.detail) == (True, "CPU 1, the only one allowed: there was nothing to choose")


def test_a_thread_with_a_place_of_its_own_keeps_it(machine: Machine) -> None:
    machine.affinity |= {MAIN: {3}, OTHER: {0, 1}}
    with pinned(LOOP) as grant:
        assert machine.affinity == {LOOP: {3}, MAIN: {3}, OTHER: {0, 1}}
    assert grant.detail == "CPU 3"


def test_a_thread_that_ends_in_between_does_not_keep_the_others_from_their_places(machine: Machine) -> None:
    with pinned(LOOP):
        del machine.affinity[MAIN]
    assert machine.affinity == {LOOP: {0, 1, 2, 3}, OTHER: {0, 1, 2, 3}}


def test_a_thread_that_ended_before_it_was_moved_is_passed_over(machine: Machine) -> None:
    del machine.affinity[MAIN]
    with pinned(LOOP) as grant:
        assert machine.affinity == {LOOP: {3}, OTHER: {0, 1, 2}}
    assert grant.detail == "CPU 3; 1 other thread moved off it"


def test_where_nothing_lists_the_threads_the_loop_has_its_processor_all_the_same(
    machine: Machine, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(processor, "_THREADS", machine.threads / "nowhere")
    with pinned(LOOP) as grant:
        assert machine.affinity == {LOOP: {3}, MAIN: {0, 1, 2, 3}, OTHER: {0, 1, 2, 3}}
    assert grant.granted


@pytest.mark.usefixtures("machine")
def test_who_is_refused_reads_what_to_do(refuse: Callable[[str, int], None]) -> None:
    refuse("os.sched_setaffinity", errno.EPERM)
    with pinned(LOOP) as grant:
        pass
    assert not grant.granted
    assert os.strerror(errno.EPERM) in grant.detail
    assert "taskset" in grant.detail
