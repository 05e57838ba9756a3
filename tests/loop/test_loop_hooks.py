"""A guard is its file and its place in the list: one that a test adds ends a run and says why, as hapsim's own do."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from loop_rig import scene_of

from firmware_protocol.compiled import new_record
from hapsim.compiling import entry
from hapsim.compiling.native import address_of, record_at
from hapsim.errors import GuardError
from hapsim.loop import endings, guards
from hapsim.loop.guards import GUARDS, HOOKS, energy_guard, in_words
from hapsim.loop.hooks import HOOKS as CALLS
from hapsim.loop.hooks import TICK, EndedRun, Guard, Hook, Setting, Stage, call_hooks, hook, io_at, set_hooks, tick_at
from hapsim.running import run

TOO_FAR = -40
BOUND = np.dtype([("most_m", np.float64), ("far_m", np.float64), ("calls", np.int64)], align=True)
BOUND_AT = record_at(BOUND)


@hook
def judge_distance(bound, tick):
    """The run ends where the hand is farther than the bound."""
    bound, tick = BOUND_AT(bound), tick_at(tick)
    bound.calls += 1
    bound.far_m = abs(io_at(tick.io).measured[0])
    return TOO_FAR if bound.far_m > bound.most_m else 0


def distance_guard(most_m: float) -> tuple[Guard, Any]:
    """The guard, and its record."""
    record = new_record(BOUND)

    def set_up(_: Any, setting: Setting) -> Any:
        record.most_m = most_m
        return record if setting.scene.channels == 1 else None

    def sentence(run: EndedRun) -> str:
        return f"the hand was {record.far_m:.3f} m away at tick {run.report.ticks}"

    return Guard("distance", BOUND, {Stage.JUDGE: judge_distance}, set_up, TOO_FAR, "too far", sentence), record


def test_a_guard_that_is_in_the_list_ends_a_run_with_its_words_and_its_sentence(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    guard, record = distance_guard(0.0005)
    monkeypatch.setattr(guards, "GUARDS", (*GUARDS, guard))
    with pytest.raises(GuardError, match=r"the hand was 0\.001 m away at tick \d+") as caught:
        run(scene_of(), duration=0.5)
    trace = caught.value.trace
    assert trace is not None
    assert trace.report.ending == "too far"
    assert record.calls == trace.report.ticks < 20
    assert np.flatnonzero(np.abs(trace.position[:, 0]) > 0.0005).tolist() == [trace.report.ticks - 1]


def test_what_it_does_not_find_changes_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    before = run(scene_of(), duration=0.1)
    guard, record = distance_guard(1.0)
    monkeypatch.setattr(guards, "GUARDS", (*GUARDS, guard))
    np.testing.assert_array_equal(run(scene_of(), duration=0.1).force_counts, before.force_counts)
    assert record.calls == 100
    run(scene_of(channels=2), duration=0.1)
    assert record.calls == 100, "a scene that does not need it does not call it"


CODE = np.dtype([("code", np.int64)])
CODE_AT = record_at(CODE)


@hook
def return_code(own, tick):  # noqa: ARG001
    return CODE_AT(own).code


@entry
def call_list(calls, tick):
    call_hooks(calls, tick)


def test_of_two_endings_in_a_tick_the_code_nearest_to_zero_is_reported() -> None:
    lists, tick, records = new_record(CALLS), new_record(TICK), [new_record(CODE) for _ in range(3)]
    tick.address = address_of(tick)
    hooks = [Hook(Stage.JUDGE, return_code, record) for record in records]
    for (first, second), expected in {(-24, -22): -22, (-22, -24): -22, (0, -24): -24, (0, 0): 0}.items():
        records[0].code, records[2].code, tick.ending = first, second, 0
        kept = set_hooks(lists, hooks)
        call_list(lists.after_limit, tick)
        assert tick.ending == expected
        del kept


def test_no_two_guards_share_a_name_a_code_or_words() -> None:
    codes = [guard.code for guard in GUARDS if guard.code]
    assert len(codes) == len(set(codes)) == len({in_words(code) for code in codes})
    assert not set(codes) & set(endings.IN_WORDS)
    assert max(codes) < min(endings.IN_WORDS)
    assert len({guard.name for guard in GUARDS}) == len(GUARDS)
    assert in_words(energy_guard.ENERGY_EXCEEDED) == "scene diverging"
    assert len(HOOKS) == sum(len({*guard.hooks.values()}) for guard in GUARDS)
