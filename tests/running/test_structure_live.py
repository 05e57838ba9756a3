"""Another structure in a running loop: what is taken, what is refused, and the force from one to the next."""

from __future__ import annotations

import contextlib
import random
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hapsim.cordis.program import parameter_values, positions_of
from hapsim.errors import UsageError
from hapsim.scene import Scene

sys.path.insert(0, str(Path(__file__).parent))
from live_structures import BEGIN, HANDS, LONE, OVER, RATE, SAMPLES, Modules, running, scene_of, work_out

LINKS = ("viscoelastic", "spring", "damper", "buffer", "friction", "plectrum")
DAMPERS = ("backward", "centred", "filtered")


def random_link(random: random.Random, between: list[str]) -> dict[str, Any]:
    kind = random.choice(LINKS)
    link: dict[str, Any] = {"type": kind, "between": between}
    if kind in ("viscoelastic", "spring", "buffer", "plectrum", "friction"):
        link["stiffness"] = random.uniform(20.0, 300.0)
    if kind in ("viscoelastic", "damper", "buffer", "plectrum"):
        link["damping"] = random.uniform(0.05, 0.4)
    if kind == "viscoelastic":
        link["damper"] = random.choice(DAMPERS)
        if link["damper"] == "filtered":
            link["cutoff"] = 200.0
    more = {"buffer": {"distance": 0.001}, "plectrum": {"release": 0.004}, "friction": {"force": 0.3}}
    return link | more.get(kind, {})


def random_change(random: random.Random, modules: Modules) -> Modules:
    """One module added, removed, retyped or linked elsewhere; a link whose end is gone goes too."""
    changed = {name: dict(module) for name, module in modules.items()}
    matter = [name for name, one in changed.items() if one["type"] in ("mass", "cell", "string")]
    links = [name for name, one in changed.items() if "between" in one]
    held = [*HANDS, "wall", *(name if changed[name]["type"] != "string" else f"{name}.2" for name in matter)]
    what = random.choice(["add point", "add link", "add link", "remove", "retype", "link elsewhere"])
    number = random.randrange(10**6)
    if what == "add point" and len(matter) < 6:
        kinds = {
            "mass": {"type": "mass", "mass": 0.05, "position": random.uniform(-0.002, 0.002)},
            "cell": {"type": "cell", "mass": 0.05, "stiffness": 100.0, "damping": 0.1, "position": 0.002},
            "string": {
                "type": "string",
                "masses": 5,
                "mass": 0.02,
                "stiffness": 200.0,
                "pluck": {"at": 2, "by": 0.002},
            },
        }
        changed[f"point{number}"] = kinds[random.choice(list(kinds))]
    elif what == "remove" and matter + links:
        gone = random.choice(matter + links)
        del changed[gone]
        changed = {
            name: one
            for name, one in changed.items()
            if not any(end.partition(".")[0] == gone for end in one.get("between", ()))
        }
    elif what == "retype" and links:
        name = random.choice(links)
        changed[name] = random_link(random, changed[name]["between"])
    elif what == "link elsewhere" and links:
        changed[random.choice(links)]["between"] = random.sample(held, 2) if len(held) > 3 else ["hand", "wall"]
    else:
        changed[f"link{number}"] = random_link(random, random.sample(held, 2))
    return changed


CHANGES = 30


@pytest.mark.thorough
def test_many_changes_of_structure(monkeypatch: pytest.MonkeyPatch) -> None:
    chance, modules, adopted = random.Random(3), BEGIN, 0
    with running(scene_of(modules), monkeypatch) as runner:
        runner.go()
        while adopted < CHANGES:
            wanted = random_change(chance, modules)
            try:
                scene = scene_of(wanted)
            except ValueError:
                continue  # two that cannot move, or the like
            if scene == runner.live.scene:
                continue
            with contextlib.suppress(UsageError):  # predicted unstable: nothing has changed
                runner.adopt(scene)
                modules, adopted = wanted, adopted + 1
            runner.go()
        expected, program = work_out(runner)
        ringing = positions_of(runner.loop.program)
        assert not runner.loop.is_replacing
    assert runner.loop.changes == CHANGES
    np.testing.assert_array_equal(np.diff(runner.sample), 1)  # no tick was missed
    np.testing.assert_array_equal(runner.asked, expected.force)
    np.testing.assert_array_equal(ringing, positions_of(program))  # to the last bit
    assert np.abs(runner.asked).max() > 0.5
    # No sample adds more than either scene does by itself, and 1.5/N of what is between them.
    steps = np.abs(np.diff(expected.force, axis=0))
    own = np.maximum(*(np.abs(np.diff(one, axis=0)) for one in (expected.older, expected.newer)))
    apart = np.abs(expected.newer - expected.older)
    bound = own + 1.5 / SAMPLES * np.maximum(apart[1:], apart[:-1])
    assert (steps <= bound + 1e-12).all()


def test_a_hand_that_is_left_alone_is_led_to_no_force(monkeypatch: pytest.MonkeyPatch) -> None:
    """And one that is taken up, from none."""
    alone = {name: one for name, one in BEGIN.items() if name not in ("thumb", "nail")}
    with running(scene_of(BEGIN), monkeypatch) as runner:
        runner.go()
        runner.adopt(scene_of(alone, mock={"initial": {"velocity": [0.2]}}))
        runner.go()
        gone = runner.asked[65:, 1].copy()
        runner.adopt(scene_of(BEGIN))
        runner.go()
        expected, _ = work_out(runner)
        come = runner.asked[130:, 1]
    assert abs(runner.asked[64, 1]) > 0.1
    assert np.abs(np.diff(gone)).max() < 0.04
    np.testing.assert_array_equal(gone[SAMPLES:], 0.0)
    assert abs(come[0]) < 0.01 * abs(come[SAMPLES])
    np.testing.assert_array_equal(runner.asked, expected.force)


@pytest.mark.parametrize(
    ("differences", "sentence"),
    [
        ({"rate": 2000.0}, "rate cannot change while the scene runs"),
        ({"substeps": 2}, "substeps cannot change while the scene runs"),
        ({"device": scene_of(BEGIN).device.model_dump() | {"mass": 0.3}}, "device.mass cannot change while the scene"),
        ({"mock": None}, "mock cannot change while the scene runs"),
        (
            {
                "modules": BEGIN | {"toe": {"type": "device", "channel": 2}},
                "mock": {"initial": {"velocity": [0.2, -0.1, 0.0]}},
            },
            r"the device has 2 channel\(s\), the scene uses 3",
        ),
        (
            {"modules": BEGIN | {"nail": BEGIN["nail"] | {"damper": "sensed"}}},
            "nail: damper: sensed needs the device's velocities",
        ),
        ({"modules": BEGIN | {"jolt": BEGIN["nail"] | {"stiffness": 1e6}}}, "unstable: the motion of thumb grows"),
        ({"modules": BEGIN | {"nail": BEGIN["nail"] | {"stiffness": 1e6}}}, "unstable: the motion of thumb grows"),
    ],
)  # fmt: skip
def test_what_cannot_be_taken_changes_nothing(monkeypatch: pytest.MonkeyPatch, differences: Any, sentence: str) -> None:
    with running(scene_of(BEGIN), monkeypatch) as runner:
        runner.go()
        before, program = runner.live.scene, runner.loop.program
        with pytest.raises((UsageError, ValueError), match=sentence):
            runner.adopt(scene_of(**{"modules": BEGIN} | differences))
        assert (runner.live.scene, runner.loop.program) == (before, program)
        runner.go()
        expected, _ = work_out(runner)
    np.testing.assert_array_equal(runner.asked, expected.force)
    assert runner.loop.changes == 0


IN_A_MATRIX = BEGIN | {
    "rod": BEGIN["rod"] | {"damping": 0.5},  # with less, a force held for a sample takes all damping from the bob
    "ball": {"type": "mass", "mass": 0.1},
    "touch": {"type": "viscoelastic", "between": ["thumb", "ball"], "stiffness": 100.0, "damping": 0.1},
    "stop": {"type": "buffer", "between": ["ball", "wall"], "stiffness": 50.0, "distance": 0.001},
}


TABLES: Modules = HANDS | {
    "wall": {"type": "ground"},
    "touch": {"type": "spring", "between": ["thumb", "wall"], "stiffness": 100.0},
    "soft": {"type": "nonlinear", "between": ["hand", "wall"], "force_over_distance": [[-0.1, -5.0], [0.1, 5.0]]},
}


def test_a_set_of_a_table_and_of_numbers_with_it_is_what_an_adoption_is(monkeypatch: pytest.MonkeyPatch) -> None:
    tables = {
        "force_over_distance": ((-0.1, -20.0), (0.0, 0.3), (0.1, 9.0)),
        "force_over_velocity": ((-1.0, -2.0), (1.0, 2.0)),
    }
    scene, changes = scene_of(TABLES), {"soft": tables, "touch": {"stiffness": 140.0}}
    wanted = scene_of(TABLES | {name: TABLES[name] | values for name, values in changes.items()})
    forces = []
    for change in (lambda live: live.set(changes, OVER), lambda live: live.adopt(wanted, OVER)):
        with running(scene, monkeypatch) as runner:
            runner.go()
            change(runner.live)
            program = runner.loop.program
            runner.go()
            assert runner.live.scene == wanted
            runner.live.set({"soft": tables}, OVER)
            assert runner.loop.program is program
            forces.append(runner.asked)
    np.testing.assert_array_equal(*forces)
    x = runner.position[:, 0]
    speed = RATE * np.diff(x, prepend=x[0])
    before, after = 50.0 * x, np.interp(x, *zip(*tables["force_over_distance"], strict=True)) + 2.0 * speed
    assert forces[0][:60, 0] == pytest.approx(-before[:60], abs=1e-6)
    assert forces[0][-30:, 0] == pytest.approx(-after[-30:], abs=1e-6)


def test_a_set_of_a_wrong_table_changes_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    scene = scene_of(TABLES)
    with running(scene, monkeypatch) as runner:
        runner.go()
        for table, told in (
            ([[0.0, 0.0], [0.0, 1.0]], r"soft.force_over_distance\[1\]\[0\]: found 0.0, expected a number > 0 m"),
            (None, "soft: found neither force_over_distance nor force_over_velocity"),
            (3.0, r"soft.force_over_distance: found 3.0, expected a list of 2 to 1000 points \[m, N\]"),
        ):
            with pytest.raises(UsageError, match=told):
                runner.live.set({"soft": {"force_over_distance": table}}, 0.0)  # type: ignore[dict-item]
        assert runner.live.scene == scene


@pytest.mark.parametrize("scheme", ["midpoint", "exact"])
def test_what_is_in_a_matrix_changes_with_the_structure_only(monkeypatch: pytest.MonkeyPatch, scheme: str) -> None:
    scene = scene_of(IN_A_MATRIX, scheme)
    with running(scene, monkeypatch) as runner:
        runner.go()
        with pytest.raises(
            UsageError, match=f"rest: cannot change while .* scheme: {scheme} compiles it into a matrix"
        ):
            runner.live.set({"rest": {"stiffness": 1.0}}, 0.0)
        assert runner.live.scene == scene
        runner.live.set({"touch": {"stiffness": 111.0}, "wall": {"position": 0.02}, "stop": {"distance": 0.003}}, 0.0)
        assert runner.live.scene.modules["touch"].stiffness == 111.0  # type: ignore[attr-defined]
        values = parameter_values(runner.live.scene)
        assert values.size == 1 + 3 * 2 + 7  # the wall, three links to hands, the buffer's table
        assert {0.02, 111.0, 0.003} < set(values)
        runner.go()

        stiffer = scene_of(IN_A_MATRIX | {"rest": IN_A_MATRIX["rest"] | {"stiffness": 320.0}}, scheme)
        before = runner.loop.program
        runner.adopt(stiffer)
        assert runner.loop.program is not before
        runner.go()
    assert runner.loop.changes == 2


def test_how_the_mock_began_changes_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    with running(scene_of(BEGIN), monkeypatch) as runner:
        runner.go()
        runner.adopt(scene_of(BEGIN | LONE, mock={"initial": {"velocity": [0.0, 0.3]}}))
        runner.go()
    assert runner.loop.changes == 1


@pytest.mark.parametrize("over", [-1.0, float("nan"), float("inf"), "x"])
def test_a_wrong_time_changes_nothing(monkeypatch: pytest.MonkeyPatch, over: Any) -> None:
    with running(scene_of(BEGIN), monkeypatch) as runner:
        with pytest.raises(UsageError, match="over: found"):
            runner.adopt(scene_of(BEGIN | LONE), over)
        assert not runner.loop.is_replacing


def test_a_change_at_once_takes_one_sample(monkeypatch: pytest.MonkeyPatch) -> None:
    with running(scene_of(BEGIN), monkeypatch) as runner:
        runner.go()
        runner.adopt(scene_of({name: one for name, one in BEGIN.items() if name != "nail"}), 0.0)
        runner.go()
    assert abs(runner.asked[64, 1]) > 0.1
    np.testing.assert_array_equal(runner.asked[65:, 1], 0.0)


def test_what_is_unstable_may_be_made_less_so(monkeypatch: pytest.MonkeyPatch) -> None:
    def nail(stiffness: float) -> Scene:
        return scene_of(BEGIN | {"nail": BEGIN["nail"] | {"stiffness": stiffness}})

    with running(nail(5e4), monkeypatch) as runner:
        with pytest.raises(UsageError, match="predicted unstable"):
            runner.live.adopt(nail(6e4), OVER)
        runner.live.adopt(nail(4e4), OVER)
        runner.live.adopt(nail(500.0), OVER)
        assert runner.live.scene == nail(500.0)
