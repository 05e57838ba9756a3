"""Verdicts on a stream of changes, which remember what the changes leave alone: a twentieth of `tools/bench/message
--verdicts 160`."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from hapsim.prediction.memory import Memory, content_of
from hapsim.prediction.plane_states import PlaneStates
from hapsim.prediction.swings import NetworkVerdict
from tests import changed_scenes, thorough

SCENES, CHANGES = thorough.points(4, 12), 2


def test_what_is_remembered_is_what_is_found_from_nothing() -> None:
    found = [changed_scenes.unlike_verdicts(seed, CHANGES) for seed in range(SCENES)]
    assert not [one for *_, unlike in found for one in unlike]
    made, refused = sum(one[0] for one in found), sum(one[1] for one in found)
    assert made > 2 * SCENES
    assert 0.03 * made < refused < 0.6 * made


def test_a_change_of_one_wall_looks_at_it_and_at_its_neighbours_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    walls = {f"w{i}": {"stiffness": 900.0 + i} for i in range(12)}
    scene = changed_scenes.row_of_walls(walls)
    found, looks = PlaneStates._found, list[str]()

    def look(self: Any, name: str) -> Any:
        looks.append(name)
        return found(self, name)

    monkeypatch.setattr(PlaneStates, "_found", look)
    changed_scenes.forget()
    changed_scenes.verdict_on(scene)
    assert {*walls} <= {*looks}
    looks.clear()
    changed_scenes.verdict_on(changed_scenes.row_of_walls(walls | {"w4": {"stiffness": 800.0}}))
    assert looks == ["w4"]


def test_a_part_that_a_change_leaves_alone_is_not_judged_again(monkeypatch: pytest.MonkeyPatch) -> None:
    judged, shaken = list[tuple[str, ...]](), NetworkVerdict._shaken
    monkeypatch.setattr(
        NetworkVerdict, "_shaken", lambda self, angle: judged.append(self.points) or shaken(self, angle)
    )
    changed_scenes.forget()
    for stiffness in (500.0, 600.0):
        judged.clear()
        changed_scenes.verdict_on(changed_scenes.cell_and_string(stiffness))
    assert ("hand", "bell") in judged
    assert not any(points[0].startswith("gut") for points in judged)


def test_the_memory_finds_anew_what_differs_and_drops_what_was_not_asked_for_longest() -> None:
    memory, calls = Memory(most=2), list[str]()

    def ask(key: str, now: dict[str, Any]) -> str:
        return memory.recall(key, lambda: (calls.append(key) or f"{key}{now['a']}", ["a"]), now)

    assert [ask("x", {"a": 1, "b": 1}), ask("x", {"a": 1, "b": 2})] == ["x1", "x1"]
    assert ask("x", {"a": 2, "b": 2}) == "x2"
    assert calls == ["x", "x"]
    for key in "yxzx":  # z drops y
        ask(key, {"a": 2})
    assert calls == ["x", "x", "y", "z"]
    ask("y", {"a": 2})
    assert calls[-1] == "y"
    assert content_of(SimpleNamespace(a=0.0)) != content_of(SimpleNamespace(a=-0.0))
