"""Another structure in a running loop: what both scenes have goes on, and the force goes smoothly from one to the next.

The loop runs in virtual time against the mock in memory, and comes back every 65 ticks, because its ring is small:
there the scene is changed. What happened is worked out once more without a loop, on the positions that were recorded:
both scenes by themselves, and the force between them as it is promised.
"""

from __future__ import annotations

import contextlib
import random
import threading
import time
from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
import pytest

import hapsim
from firmware_protocol import schema
from firmware_protocol.description import Description
from hapsim.cordis.offline import follow_parameters, start, take_over, tick
from hapsim.cordis.program import Program, compile_scene, numbers_of, parameter_values, positions_of
from hapsim.cordis.succession import take_over_from
from hapsim.device.conversation import arm, describe, disarm
from hapsim.device.open_connection import open_connection
from hapsim.errors import UsageError
from hapsim.loop import endings
from hapsim.loop.ring import RingRows
from hapsim.loop.run import run_loop
from hapsim.prediction import is_surely_unstable, predict, surely_shaken_by
from hapsim.running import assemble
from hapsim.running.assemble import Loop, assemble_loop
from hapsim.running.changes import LiveScene, differs_in_live_parameters_alone
from hapsim.scene import Scene

RATE = 1000.0
OVER = 0.02
SAMPLES = 20
Modules = dict[str, dict[str, Any]]

HANDS: Modules = {"hand": {"type": "device", "channel": 0}, "thumb": {"type": "device", "channel": 1}}
STRING: dict[str, Any] = {"type": "string", "masses": 9, "mass": 0.01, "stiffness": 400.0}
LINKS = ("viscoelastic", "spring", "damper", "buffer", "friction", "plectrum")
DAMPERS = ("backward", "centred", "filtered")


def scene_of(modules: Modules, scheme: str = "cordis", **differences: Any) -> Scene:
    device = {"mass": 0.2, "friction": 2.0, "clock": "lockstep", "force_limit": 50.0}
    mock = {"initial": {"velocity": [0.2, -0.1]}}
    document = {"version": 1, "rate": RATE, "scheme": scheme, "device": device, "mock": mock, "modules": modules}
    return Scene.model_validate(document | differences)


class Change(NamedTuple):
    """A scene that was adopted before the row of this number."""

    row: int
    scene: Scene


class Runner:
    """A loop that comes back every 65 ticks, all of them recorded."""

    def __init__(self, scene: Scene, loop: Loop) -> None:
        self.loop, self.live = loop, LiveScene(scene, loop)
        self.changes = [Change(0, scene)]
        self._parts: list[RingRows] = []
        self.rows = 0

    def go(self) -> None:
        """65 ticks."""
        assert run_loop(self.loop.record) == endings.RING_FULL
        self._parts.append(self.loop.ring.drain())
        self.rows += self._parts[-1].sample.size

    def adopt(self, scene: Scene, over: float = OVER) -> None:
        self.live.adopt(scene, over)
        self.changes.append(Change(self.rows, scene))

    @property
    def sample(self) -> np.ndarray:
        return np.concatenate([part.sample for part in self._parts])

    @property
    def position(self) -> np.ndarray:
        """(N, channels) m."""
        counts = np.concatenate([part.position for part in self._parts])
        return counts * self.loop.record.io.position_scale[: counts.shape[1]]

    @property
    def asked(self) -> np.ndarray:
        """(N, channels) N."""
        return np.concatenate([part.asked for part in self._parts])


@contextlib.contextmanager
def running(scene: Scene, monkeypatch: pytest.MonkeyPatch) -> Iterator[Runner]:
    monkeypatch.setattr(assemble, "_RING_ROWS", 128)
    with open_connection(scene, "loopback") as connection:
        description: Description = describe(connection)
        loop = assemble_loop(scene, connection, description)
        arm(connection, description, schema.LOCKSTEP, 100)
        try:
            yield Runner(scene, loop)
        finally:
            disarm(connection, loop.wire)


class Expected(NamedTuple):
    """Worked out without a loop: forces in N, and where each is between an older scene's and a newer one's."""

    force: np.ndarray
    older: np.ndarray
    newer: np.ndarray


def work_out(runner: Runner) -> tuple[Expected, Program]:
    """The forces of a run's scenes on the positions that it recorded; and the last scene's program, at the end."""
    position = runner.position
    changes = {change.row: change.scene for change in runner.changes}
    scene = changes.pop(0)
    program, older, left = compile_scene(scene), None, 0
    start(program, position[0])
    channels = position.shape[1]
    forces = np.zeros((3, *position.shape))
    still = np.zeros(channels)
    for n, measured in enumerate(position):
        if n in changes and differs_in_live_parameters_alone(scene, changes[n]):
            scene = changes[n]
            program.parameters.post(parameter_values(scene), SAMPLES)
        elif n in changes:
            older, older_scene, scene, left = program, scene, changes[n], SAMPLES
            program = compile_scene(scene)
            take_over_from(older, older_scene, program, scene)
            take_over(older, program, measured)
            program.parameters.post(parameter_values(scene), SAMPLES)
        for one, into in ((older, forces[1, n]), (program, forces[2, n])):
            if one is not None:
                follow_parameters(one)
                tick(one, measured, still, into)
        left = max(left - 1, 0)
        s = 1.0 - left / SAMPLES
        weight = s * s * (3.0 - 2.0 * s)
        forces[0, n] = forces[1, n] + weight * (forces[2, n] - forces[1, n]) if left else forces[2, n]
        if left == 0:
            older = None
            forces[1, n] = forces[2, n]
    return Expected(*forces), program


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


BEGIN: Modules = HANDS | {
    "wall": {"type": "ground"},
    "bob": {"type": "mass", "mass": 0.05, "velocity": 0.3},
    "rod": {"type": "viscoelastic", "between": ["hand", "bob"], "stiffness": 200.0, "damping": 0.1},
    "rest": {"type": "spring", "between": ["bob", "wall"], "stiffness": 300.0},
    "nail": {"type": "viscoelastic", "between": ["thumb", "wall"], "stiffness": 500.0, "damping": 1.0},
}


CHANGES = 250


def test_hundreds_of_changes_of_structure(monkeypatch: pytest.MonkeyPatch) -> None:
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


ON_ONE_LINK: Modules = {"hand": {"type": "device", "channel": 0}, "wall": {"type": "ground", "position": 0.001}}
ONE_OF_EACH: Modules = {
    "viscoelastic": {"stiffness": 400.0, "damping": 0.5},
    "centred": {"type": "viscoelastic", "stiffness": 400.0, "damping": 0.5, "damper": "centred"},
    "filtered": {"type": "viscoelastic", "stiffness": 400.0, "damping": 0.5, "damper": "filtered", "cutoff": 80.0},
    "spring": {"stiffness": 400.0},
    "damper": {"damping": 0.5},
    "buffer": {"stiffness": 400.0, "damping": 0.5, "distance": 0.002},
    "nonlinear": {"force_over_distance": [[-0.01, -2.0], [0.0, 0.0], [0.01, 3.0]]},
    "friction": {"force": 0.2, "static": 0.3, "stiffness": 300.0, "damping": 0.2},
    "plectrum": {"stiffness": 400.0, "damping": 0.1, "release": 0.003},
}
MATTER: Modules = {
    "bob": {"type": "mass", "mass": 0.05, "velocity": 0.3},
    "bell": {"type": "cell", "mass": 0.05, "stiffness": 300.0, "damping": 0.1, "rest": 0.001, "position": 0.003},
    "string": STRING | {"damping": 0.01, "pluck": {"at": 4, "by": 0.002}},
    "rod": STRING | {"bending": 40.0, "ends": ["clamped", "free"]},
    "drum": {"type": "membrane", "rows": 4, "columns": 5, "mass": 0.01, "stiffness": 200.0, "edges": ["free"] * 4},
}
HELD_BY: Modules = {
    f"to_{name}": {"type": "viscoelastic", "between": ["hand", end], "stiffness": 100.0, "damping": 0.05}
    for name, end in (("bob", "bob"), ("bell", "bell"), ("string", "string.3"), ("rod", "rod.5"), ("drum", "drum.0.2"))
}
SCHEMES = ("cordis", "semi_implicit", "midpoint", "rk4", "exact")


def swing(ticks: int) -> np.ndarray:
    """(N, 1) m: a hand that moves to and fro, and stands still for a while in between."""
    t = np.arange(ticks) / RATE
    return (0.004 * np.sin(2.0 * np.pi * 11.0 * t) * (np.abs(t - 0.06) > 0.01))[:, None]


def played(scene: Scene, positions: np.ndarray, change: Scene | None = None, at: int = 0) -> tuple[np.ndarray, Program]:
    """The forces (N, 1) in a hand at these positions; before tick `at`, another scene takes over."""
    program, still, force = compile_scene(scene), np.zeros(1), np.zeros((len(positions), 1))
    start(program, positions[0])
    for n, measured in enumerate(positions):
        if change is not None and n == at:
            older, program = program, compile_scene(change)
            take_over_from(older, scene, program, change)
            take_over(older, program, measured)
        follow_parameters(program)
        tick(program, measured, still, force[n])
    return force, program


LONE: Modules = {"lone": {"type": "mass", "mass": 0.1, "velocity": 0.1}, "first": {"type": "ground", "position": 1.0}}


@pytest.mark.parametrize("name", ONE_OF_EACH)
@pytest.mark.parametrize("at", [1, 37, 66, 113])
def test_a_change_elsewhere_is_not_felt_on_any_link(name: str, at: int) -> None:
    """To the last bit: what links remember goes on too. At 66 the hand stands still; by 113 all have slid or let go."""
    link = {"type": name, "between": ["hand", "wall"]} | ONE_OF_EACH[name]
    before = scene_of(ON_ONE_LINK | {"link": link}, mock=None)
    after = scene_of(LONE | ON_ONE_LINK | {"link": link}, mock=None)
    force, _ = played(before, swing(200))
    changed, _ = played(before, swing(200), after, at)
    assert np.abs(force).max() > 0.1
    np.testing.assert_array_equal(changed, force)


@pytest.mark.parametrize("scheme", SCHEMES)
def test_a_change_elsewhere_is_not_felt_on_any_matter(scheme: str) -> None:
    modules = ON_ONE_LINK | MATTER | HELD_BY
    before, after = scene_of(modules, scheme, mock=None), scene_of(LONE | modules, scheme, mock=None)
    force, _ = played(before, swing(200))
    changed, _ = played(before, swing(200), after, 60)
    assert np.abs(force).max() > 0.1
    # What is worked into matrices is rounded otherwise in other matrices, and a step is not stored between programs.
    rounding = {"semi_implicit": 1e-13, "midpoint": 1e-11, "exact": 1e-11}
    np.testing.assert_allclose(changed, force, rtol=0.0, atol=rounding.get(scheme, 0.0))


@pytest.mark.parametrize("wanted", SCHEMES)
@pytest.mark.parametrize("scheme", SCHEMES)
@pytest.mark.parametrize("damping", [0.0, 0.3])
def test_points_go_on_from_scheme_to_scheme(scheme: str, wanted: str, damping: float) -> None:
    """All are where they were, and were before, to the last bit; and a tick on where either scheme takes them. With a
    damper between two masses the exact scheme is one matrix, without it is modes."""
    more: Modules = {"brake": {"type": "damper", "between": ["bob", "bell"], "damping": damping}}
    modules = ON_ONE_LINK | MATTER | HELD_BY | more
    before, after = scene_of(modules, scheme, mock=None), scene_of(modules, wanted, mock=None)
    positions = swing(62)
    _, older = played(before, positions[:60])
    program = compile_scene(after)
    take_over_from(older, before, program, after)
    take_over(older, program, positions[60])
    points = [number for name, number in numbers_of(before).items() if name not in ON_ONE_LINK]
    np.testing.assert_array_equal(np.array(positions_of(program))[:, points], np.array(positions_of(older))[:, points])
    for one, scene in ((older, before), (program, after)):
        tick(one, positions[60], np.zeros(1), np.zeros(1))
        put_all_points(one, scene, positions[61])
    ahead = [positions_of(one)[0][points] for one in (program, older)]
    np.testing.assert_allclose(*ahead, rtol=0.0, atol=2e-5)


def put_all_points(program: Program, scene: Scene, measured: np.ndarray) -> None:
    """The exact scheme puts only those somewhere that something looks at, until another program takes over."""
    following = compile_scene(scene)
    take_over_from(program, scene, following, scene)
    take_over(program, following, measured)


@pytest.mark.parametrize(("precision", "wanted"), [("single", "double"), ("double", "single")])
def test_points_go_on_in_another_precision(precision: str, wanted: str) -> None:
    modules = ON_ONE_LINK | MATTER | HELD_BY
    before = scene_of(modules, mock=None, precision=precision)
    after = scene_of(modules, mock=None, precision=wanted)
    positions = swing(120)
    force, _ = played(before, positions)
    changed, _ = played(before, positions, after, 60)
    np.testing.assert_allclose(changed, force, rtol=0.0, atol=2e-4)
    np.testing.assert_array_equal(changed[:60], force[:60])


def test_live_parameters_go_on_from_where_they_are() -> None:
    """A ground on its way, and a stiffness: neither jumps where another structure takes over."""
    link = {"type": "spring", "between": ["hand", "wall"], "stiffness": 100.0}
    before = scene_of(ON_ONE_LINK | {"link": link}, mock=None)
    moved = ON_ONE_LINK | {"wall": {"type": "ground", "position": 0.011}}
    after = scene_of(LONE | moved | {"link": link | {"stiffness": 300.0}}, mock=None)
    program, still, rest = compile_scene(before), np.zeros(1), np.zeros(1)
    start(program, rest)
    force = np.zeros((200, 1))
    for n in range(200):
        if n == 50:
            program.parameters.post(
                parameter_values(before.model_copy(update={"modules": after.modules})), 0
            ) if False else None
            older, program = program, compile_scene(after)
            take_over_from(older, before, program, after)
            take_over(older, program, rest)
            program.parameters.post(parameter_values(after), 100)
        follow_parameters(program)
        tick(program, rest, still, force[n])
    assert force[49] == pytest.approx(100.0 * 0.001)
    assert force[-1] == pytest.approx(300.0 * 0.011)
    assert (np.diff(force[:, 0]) >= 0.0).all()
    assert np.diff(force[:, 0]).max() < 0.06  # at most 1.5/100 of either's way at a time


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


@pytest.mark.parametrize("scheme", ["midpoint", "exact"])
def test_what_is_in_a_matrix_is_no_live_parameter_and_changes_with_the_structure(
    monkeypatch: pytest.MonkeyPatch, scheme: str
) -> None:
    scene = scene_of(IN_A_MATRIX, scheme)
    with running(scene, monkeypatch) as runner:
        runner.go()
        with pytest.raises(UsageError, match=f"rest: nothing of it can change .* scheme: {scheme} makes once"):
            runner.live.set({"rest": {"stiffness": 1.0}}, 0.0)
        assert runner.live.scene == scene
        runner.live.set({"touch": {"stiffness": 111.0}, "wall": {"position": 0.02}, "stop": {"distance": 0.003}}, 0.0)
        assert runner.live.scene.modules["touch"].stiffness == 111.0  # type: ignore[attr-defined]
        values = parameter_values(runner.live.scene)
        assert values.size == 1 + 3 * 2 + 3  # the wall, three links to hands, the buffer
        assert {0.02, 111.0, 0.003} < set(values)

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


@pytest.mark.parametrize(
    ("stiffness", "unstable"), [(300.0, False), (3e4, True), (1e5, True)], ids=["soft", "stiff", "stiffer"]
)
@pytest.mark.parametrize("more", [{}, LONE], ids=["a hand alone", "beside a mass"])
def test_what_is_surely_unstable_is_found_as_by_the_whole_prediction(
    stiffness: float, unstable: bool, more: Modules
) -> None:
    nail = {"type": "viscoelastic", "between": ["thumb", "wall"], "stiffness": stiffness, "damping": 1.0}
    for scheme in ("cordis", "exact"):
        scene = scene_of(HANDS | {"wall": BEGIN["wall"], "nail": nail} | more, scheme)
        shaken, predicted = surely_shaken_by(scene), predict(scene, with_margins=False)
        found = shaken is not None
        assert found == is_surely_unstable(predicted) == unstable
        assert shaken is None or shaken == (predicted.spectral_radius, "thumb")


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


RUBS: dict[str, Any] = {"type": "friction", "force": 5.0, "stiffness": 300.0, "damping": 0.2}


@pytest.mark.parametrize(
    ("before", "after"),
    [
        ({}, {"rub": RUBS | {"between": ["hand", "wall"]}}),
        ({"rub": RUBS | {"between": ["hand", "far"]}}, {"rub": RUBS | {"between": ["hand", "wall"]}}),
        (
            {"string": STRING | {"masses": 5}, "rub": RUBS | {"between": ["hand", "string.2"]}},
            {"string": STRING | {"masses": 6}, "rub": RUBS | {"between": ["hand", "string.2"]}},
        ),
    ],
    ids=["new", "linked elsewhere", "to a string of another length"],
)
def test_a_link_that_is_new_remembers_nothing(before: Modules, after: Modules) -> None:
    """Its bristle is not bent at a hand that moves: what it is felt by is its damper."""
    around = ON_ONE_LINK | {"far": {"type": "ground", "position": 0.1}}
    position = swing(60)
    old, new = scene_of(around | before, mock=None), scene_of(around | after, mock=None)
    force, _ = played(old, position, new, at=30)
    step = (position[30] - position[29]) * RATE
    assert abs(step[0]) > 0.1
    np.testing.assert_allclose(force[30], -RUBS["damping"] * step, rtol=1e-9)


def test_what_is_unstable_may_be_made_less_so(monkeypatch: pytest.MonkeyPatch) -> None:
    def nail(stiffness: float) -> Scene:
        return scene_of(BEGIN | {"nail": BEGIN["nail"] | {"stiffness": stiffness}})

    with running(nail(5e4), monkeypatch) as runner:
        with pytest.raises(UsageError, match="predicted unstable"):
            runner.live.adopt(nail(6e4), OVER)
        runner.live.adopt(nail(4e4), OVER)
        runner.live.adopt(nail(500.0), OVER)
        assert runner.live.scene == nail(500.0)


def test_a_set_does_not_wait_for_a_structure_that_waits(monkeypatch: pytest.MonkeyPatch) -> None:
    with running(scene_of(BEGIN), monkeypatch) as runner:
        over = threading.Event()
        live = LiveScene(scene_of(BEGIN), runner.loop, over.is_set)
        live.adopt(scene_of(BEGIN | LONE), OVER)  # the loop does not run: it is never through
        waits = threading.Thread(target=_adopt_in_vain, args=(live, scene_of(BEGIN)))
        waits.start()
        live.set({"nail": {"stiffness": 400.0}}, 0.0)
        assert waits.is_alive()
        over.set()
        waits.join()
        assert live.scene.modules["nail"].stiffness == 400.0  # type: ignore[attr-defined]


def _adopt_in_vain(live: LiveScene, scene: Scene) -> None:
    with pytest.raises(UsageError, match="the run is over"):
        live.adopt(scene, OVER)


def test_changes_follow_one_another() -> None:
    """Whoever changes a scene waits until the change before is through."""
    with hapsim.start(scene_of(BEGIN)) as session:
        for n in range(10):
            session.adopt(scene_of(BEGIN | (LONE if n % 2 == 0 else {})), over=0.05)
        while session._loop.is_replacing:  # until then what is set goes together with the last of them
            time.sleep(0.001)
        session.set({"nail": {"stiffness": 400.0}})
        assert session.scene.modules["nail"].stiffness == 400.0  # type: ignore[attr-defined]
        ticks = session.progress().elapsed_s
        while session.progress().elapsed_s < ticks + 1.0:
            time.sleep(0.001)
        session.stop()
    assert session.trace.report.parameter_changes == 11
    np.testing.assert_array_equal(np.diff(session.trace.sample), 1)


def test_several_threads_change_it() -> None:
    def adopt(session: hapsim.Session, name: str) -> None:
        for n in range(5):
            session.adopt(scene_of(BEGIN | ({name: {"type": "mass", "mass": 0.1 + n}})), over=0.01)

    with hapsim.start(scene_of(BEGIN)) as session:
        threads = [threading.Thread(target=adopt, args=(session, f"by{i}")) for i in range(3)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        session.stop()
    np.testing.assert_array_equal(np.diff(session.trace.sample), 1)
    assert np.isfinite(session.trace.asked_force).all()


def test_who_waits_for_a_change_is_let_go_when_the_run_is_over(monkeypatch: pytest.MonkeyPatch) -> None:
    with running(scene_of(BEGIN), monkeypatch) as runner:
        over = threading.Event()
        live = LiveScene(scene_of(BEGIN), runner.loop, over.is_set)
        live.adopt(scene_of(BEGIN | LONE), OVER)
        threading.Timer(0.05, over.set).start()
        with pytest.raises(UsageError, match="the run is over"):
            live.adopt(scene_of(BEGIN), OVER)
