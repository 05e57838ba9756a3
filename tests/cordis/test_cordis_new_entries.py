"""A new link, damper or scheme needs one entry per package and nothing else. Those here are not shipped. The kernel
runs and the theory predicts each, and both agree with its formula."""

from __future__ import annotations

import importlib
import sys
from collections.abc import Sequence
from typing import Annotated, Any, ClassVar, Literal, NamedTuple

import numpy as np
import pytest
from pydantic import Field

import hapsim
from firmware_protocol.compiled import new_record
from hapsim.compiling.native import address_of, value_of
from hapsim.cordis import program as programs
from hapsim.cordis.build_context import BuildContext, PresentType, Scheme
from hapsim.cordis.dispatch import Batch, Column, action, fma_action
from hapsim.cordis.modules.linear_links import damped_type, initialize_centred
from hapsim.cordis.modules.link import Ends, count, link_type, pull_ends, pull_link, stretch
from hapsim.cordis.offline import start, tick
from hapsim.cordis.program import PART_TYPES, compile_scene, numbers_of, parameter_values, positions_of
from hapsim.cordis.schemes import SCHEMES
from hapsim.cordis.schemes.force_expansion import first_moved, mobility_of_all
from hapsim.cordis.stored_energy import TANK, StoredEnergy, Tank, evaluate
from hapsim.dampers import DAMPERS, Damper, DamperModel
from hapsim.laws import Law, Potential, line
from hapsim.prediction import predict
from hapsim.scene import Scene, parse_scene
from hapsim.scene.modules import Link
from hapsim.scene.quantity import quantity
from hapsim.scene.section import Table
from hapsim.theory import schemes as theory

RATE, K, B = 1000.0, 900.0, 0.7
TEXT = f"""
version: 1
rate: {RATE}
device: {{clock: lockstep, mass: 0.2, friction: 1, delay: 1.3}}
modules:
  hand: {{type: device, channel: 0}}
  wall: {{type: ground}}
  it: {{type: viscoelastic, between: [hand, wall], stiffness: {K}, damping: {B}}}
"""


def with_it(link: Any) -> Scene:
    """A hand on this link."""
    scene = parse_scene(TEXT)
    return scene.model_copy(update={"modules": Table(dict(scene.modules) | {"it": link})})


def tensions(scene: Scene, d: np.ndarray) -> np.ndarray:
    """N, of the link that the hand stretches by d, in m."""
    program, force = compile_scene(scene), np.zeros((len(d), 1))
    start(program, d[:1])
    for n in range(len(d)):
        tick(program, d[n : n + 1], np.zeros(1), force[n])
    return -force[:, 0]


@pytest.fixture
def d() -> np.ndarray:
    return 0.01 * np.sin(np.cumsum(np.random.default_rng(5).normal(size=300)) / 9.0)


# A link with knots: its class, which makes its law.


class Hardening(Link):
    """A spring that is three times as stiff farther than 5 mm from where its ends coincide."""

    spaces: ClassVar[tuple[int, ...]] = (1, 2)
    has_table: ClassVar[bool] = True
    live: ClassVar[tuple[str, ...]] = ("stiffness",)

    type: Literal["hardening"] = Field(default="hardening", description="A spring that hardens")
    stiffness: Annotated[float, quantity("Stiffness within 5 mm", "N/m", least=0)]

    def law(self) -> Law:
        k = self.stiffness
        knots = ((-0.005, -0.005 * k), (0.005, 0.005 * k))
        return Law(knots, (B, 0.0, B), ("stiff", "soft", "stiff"), 3.0 * k, 3.0 * k)


def stored(scene: Scene, *place: float) -> tuple[float, float]:
    """Returns the stored energy, J, with the hand at a place, m, and what it becomes for twice the stiffness."""
    program, tank = compile_scene(scene), new_record(TANK)
    Tank(tank, capacity_j=1.0, refill_j=0.0)
    start(program, np.array(place))
    account, here = StoredEnergy(program, scene, tank, np.inf), positions_of(program)
    energy = evaluate(account._record.address, *map(address_of, here), 0)
    link = scene.modules["it"]
    stiffer = link.model_copy(update={"stiffness": 2.0 * link.stiffness})
    changed = scene.model_copy(update={"modules": Table(dict(scene.modules) | {"it": stiffer})})
    program.parameters.values[:] = parameter_values(changed)
    return energy, evaluate(account._record.address, *map(address_of, here), 0)


def test_a_link_with_knots_is_its_law(d: np.ndarray) -> None:
    link = Hardening(between=("hand", "wall"), stiffness=K)
    scene, beyond = with_it(link), np.abs(d) - 0.005
    stiff = np.sign(d) * K * (np.minimum(np.abs(d), 0.005) + 3.0 * np.maximum(beyond, 0.0))
    damper = B * RATE * np.diff(d, prepend=d[0]) * (beyond > 0.0)
    np.testing.assert_allclose(tensions(scene, d), stiff + damper, atol=1e-9)
    assert stored(scene, 0.007) == pytest.approx((0.5 * K * 57e-6, K * 57e-6))
    prediction = predict(scene)
    assert [one.piece.states["it"] for one in prediction.regions_of("hand")] == ["stiff", "soft", "stiff"]
    assert predict(scene, at=0.01).felt[0].k > 2.9 * prediction.felt[0].k
    assert not predict(with_it(Hardening(between=("hand", "wall"), stiffness=2e5))).stable


def test_a_link_with_knots_is_its_law_in_the_plane_too(d: np.ndarray) -> None:
    text = TEXT.replace("version: 1", "version: 1\nspace: 2").replace("channel: 0", "channels: [0, 1]")
    flat = parse_scene(text).modules
    link = Hardening(between=("hand", "wall"), stiffness=K)
    scene = parse_scene(text).model_copy(update={"modules": Table(dict(flat) | {"it": link})})
    path = np.stack([0.6 * (0.012 + 0.2 * d), 0.8 * (0.012 + 0.2 * d)], axis=1)
    program, force = compile_scene(scene), np.zeros_like(path)
    start(program, path[0])
    for n, place in enumerate(path):
        tick(program, place, np.zeros(2), force[n])
    r = np.hypot(*path.T)
    stiff = K * (0.005 + 3.0 * (r - 0.005)) + B * RATE * np.diff(r, prepend=r[0])
    np.testing.assert_allclose(force, -stiff[:, None] * [0.6, 0.8], atol=1e-9)
    assert stored(scene, 0.0, 0.007) == pytest.approx((0.5 * K * 57e-6, K * 57e-6))
    found = predict(scene, at=(0.0, 0.007))
    assert [one.state for one in found.links] == ["stiff"]
    growing = [one.state for one in predict(scene, at=(0.0, 0.001)).states.growing]
    assert any(state.startswith("it is stiff") for state in growing)
    assert np.diag(found.parts[0].static_stiffness) == pytest.approx([K * 0.011 / 0.007, 3.0 * K])


# A link with a recurrence of its own: its class, which makes its law, and its part of a program.


class Doubled(Link):
    """A spring of twice its stiffness."""

    potential = (Potential((("stiffness", 2.0),)),)
    live: ClassVar[tuple[str, ...]] = ("stiffness",)

    type: Literal["doubled"] = Field(default="doubled", description="A spring of twice its stiffness")
    stiffness: Annotated[float, quantity("Half of it", "N/m", least=0)]

    def law(self) -> Law:
        return line(2.0 * self.stiffness, 0.0)


class DoubledLinks(NamedTuple):
    ends: Ends
    stiffness: Column


@action
def add_doubled_forces(links, state):
    links, state = value_of(links), value_of(state)
    for i in range(count(links.ends)):
        tension = links.stiffness[i] * stretch(links.ends, i, state.position)
        pull_ends(links.ends, i, tension + tension, state.force)


def test_a_link_is_a_class_and_a_part_of_a_program(monkeypatch: pytest.MonkeyPatch, d: np.ndarray) -> None:
    kind = link_type(Doubled, DoubledLinks, add_doubled_forces, "doubled springs")
    monkeypatch.setattr(programs, "PART_TYPES", (*PART_TYPES, kind))
    scene = with_it(Doubled(between=("hand", "wall"), stiffness=K))
    np.testing.assert_allclose(tensions(scene, d), 2.0 * K * d, rtol=1e-12)
    assert stored(scene, 0.007) == pytest.approx((K * 49e-6, 2.0 * K * 49e-6))
    spring = parse_scene(
        TEXT.replace(f"stiffness: {K}", f"stiffness: {2.0 * K}").replace(f"damping: {B}", "damping: 0")
    )
    felt, expected = (predict(one, with_margins=False).felt[0] for one in (scene, spring))
    assert (felt.k, felt.b) == pytest.approx((expected.k, expected.b), rel=1e-12)


def test_a_class_in_the_file_of_links_is_a_type_that_scene_files_have(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("hapsim.scene.modules.links.Doubled", Doubled, raising=False)
    for name in ("modules", "scene", "load"):  # imported anew, with that class
        monkeypatch.setattr(hapsim.scene, name, sys.modules[f"hapsim.scene.{name}"])
        monkeypatch.delitem(sys.modules, f"hapsim.scene.{name}")
    load = importlib.import_module("hapsim.scene.load")
    text = TEXT.replace("viscoelastic", "doubled").replace(f", damping: {B}", "")
    assert type(load.parse_scene(text).links["it"]).__name__ == "Doubled"
    with pytest.raises(hapsim.errors.SceneError, match="click, doubled, detent, shape or guide"):
        load.parse_scene(text.replace("doubled", "nothing"))


# A damper: an entry of DAMPERS, and its part of a program.


@fma_action
def add_late_forces(links, state):
    links, state = value_of(links), value_of(state)
    for i in range(count(links.ends)):
        before = stretch(links.ends, i, state.previous)
        pull_link(links, i, stretch(links.ends, i, state.position), before - links.remembered[i], state.force)
        links.remembered[i] = before


def test_a_damper_is_an_entry_and_a_part_of_a_program(monkeypatch: pytest.MonkeyPatch, d: np.ndarray) -> None:
    late = Damper("the last but one", lambda _: DamperModel(of_positions=(0.0, 1.0, -1.0)))
    monkeypatch.setitem(DAMPERS, "late", late)
    kind = damped_type("late", "", add_late_forces, lambda *_: 0.0, initialize_centred)
    monkeypatch.setattr(programs, "PART_TYPES", (*PART_TYPES, kind))
    scene = with_it(parse_scene(TEXT).links["it"].model_copy(update={"damper": "late"}))
    before = np.concatenate([d[:1], d[:1], d])
    np.testing.assert_allclose(tensions(scene, d), K * d + B * RATE * (before[1:-1] - before[:-2]), atol=1e-12)
    felt, found = predict(scene, with_margins=False).felt[0], hapsim.measure(scene)
    assert (found.k, found.b) == pytest.approx((felt.k, felt.b), rel=3e-6)


# A scheme: its parts of a program, and how the theory steps it.


class EulerSteps(NamedTuple):
    start: np.uint64
    mobility: Column
    step: Column


@action
def go_on(points, state):
    """The forward Euler rule: x[n+1] = x[n] + w[n], w[n+1] = w[n] + (T²/m) F[n]."""
    points, state = value_of(points), value_of(state)
    for i in range(np.uint64(points.step.size)):
        p = points.start + i
        state.previous[p] = state.position[p] + points.step[i]
        points.step[i] += points.mobility[i] * state.force[p]
        state.position[p] = state.previous[p] - points.step[i]
        state.force[p] = 0.0


def _parts(scene: Scene, context: BuildContext, taken: Sequence[PresentType]) -> tuple[Batch, ...]:
    mobility = mobility_of_all(scene, context)
    steps = EulerSteps(np.uint64(first_moved(scene)), mobility, np.zeros_like(mobility))
    return (*(one.build(context) for one in taken if not one.kind.moves_points), Batch(steps, integrate=go_on))


def test_a_scheme_is_its_parts_and_an_entry_of_the_theory(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(SCHEMES, "euler", Scheme(_parts))
    euler = theory.Scheme(lambda rates, z, held: rates @ z + held, lambda _link: True)
    monkeypatch.setitem(theory.SCHEMES, "euler", euler)
    text = TEXT.replace("modules:", "modules:\n  m: {type: mass, mass: 0.05, position: 0.01}")
    text = text.replace("[hand, wall]", "[m, wall]").replace(f"damping: {B}", "damping: 0")
    scene = parse_scene(text).model_copy(update={"scheme": "euler"})
    pole = 1.0 + 1j * np.sqrt(K / 0.05) / RATE
    poles = np.array(predict(scene, with_margins=False).poles)
    assert min(abs(poles - pole)) < 1e-12
    program, force = compile_scene(scene), np.zeros(1)
    start(program, np.zeros(1))
    for n in range(50):
        assert positions_of(program)[0][numbers_of(scene)["m"]] == pytest.approx(0.01 * (pole**n).real, abs=1e-12)
        tick(program, np.zeros(1), np.zeros(1), force)
