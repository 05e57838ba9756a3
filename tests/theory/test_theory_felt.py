"""Feel of a hand that moves masses or another hand, against independent figures, limits, and the mock's motion."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import yaml
from numpy.typing import NDArray

from hapsim import predict
from hapsim.prediction import OwnMotion, Part
from hapsim.running.run import run_in_memory
from hapsim.scene import Scene, parse_scene
from hapsim.theory import Configuration, Network
from hapsim.theory.network import continuous_mass, felt_mass, felt_pair
from hapsim.theory.network.felt import ANSWERS
from tests import thorough
from tests.pair_scenes import flicked, judged

SEEDS = range(thorough.points(4, 12))
HAND = {"hand": {"type": "device", "channel": 0}, "wall": {"type": "ground"}}


def link(first: str, second: str, stiffness: float, damping: float) -> dict[str, Any]:
    return {"type": "viscoelastic", "between": [first, second], "stiffness": stiffness, "damping": damping}


def scene_of(modules: dict[str, Any], **more: Any) -> Scene:
    device = {"mass": 0.2, "friction": 1.0, "clock": "lockstep"} | more.pop("device", {})
    document = {"version": 1, "rate": 1000, "device": device, "modules": HAND | modules} | more
    return parse_scene(yaml.safe_dump(document, sort_keys=False), "scene")


def together(modules: dict[str, Any], **more: Any) -> Part:
    (found,) = predict(scene_of(modules, **more), with_margins=False).parts
    return found


def mass(kg: float) -> dict[str, Any]:
    return {"type": "mass", "mass": kg}


class TestFiguresWorkedOutElsewhere:
    """Figures with 50 digits, for a hand of 0.2 kg and 1 N·s/m at 1 kHz with one sample of delay."""

    def test_through_a_light_mass(self) -> None:
        couple = link("hand", "proxy", 769.800358920, 0.281766487)
        one = together({"proxy": mass(0.02), "couple": couple, "hold": link("proxy", "wall", 2000.0, 5.0)})
        assert (one.felt.k[0, 0], one.felt.b[0, 0]) == pytest.approx((554.143495968, 0.708624809), rel=1e-9)
        wanted = one.desired.k[0, 0], one.desired.b[0, 0]
        assert wanted == pytest.approx((552.901493894, 1.535624061), rel=1e-9)
        assert one.felt.share == pytest.approx(0.99209, abs=1e-5)

    def test_on_a_heavy_mass_that_it_then_follows(self) -> None:
        """The figures are those of its own motion; after an impulse it moves with the mass much further, and slower."""
        modules = {"block": mass(5.0), "touch": link("hand", "block", 2000.0, 5.0)}
        one = together(modules | {"hold": link("block", "wall", 100.0, 1.0)})
        assert one.felt.reason == ANSWERS
        assert one.felt.share == pytest.approx(0.96, abs=5e-3)
        own = felt_pair(one.network, most=1.0)
        assert (own.k[0, 0], own.b[0, 0]) == pytest.approx((2165.5, 3.189), rel=1e-4)

    def test_on_a_wall_with_another_mass(self) -> None:
        one = together(
            {"ball": mass(0.5), "touch": link("hand", "wall", 2000.0, 5.0), "beside": link("hand", "ball", 20.0, 0.1)}
        )
        assert (one.felt.k[0, 0], one.felt.b[0, 0]) == pytest.approx((2103.3, 3.094), rel=1e-4)

    def test_a_free_mass_of_which_no_motion_is_the_hand_s(self) -> None:
        one = together({"ball": mass(1.0), "touch": link("hand", "ball", 2000.0, 5.0)})
        assert one.felt.reason
        assert np.isnan(one.felt.k).all()
        assert one.own_motion is None

    def test_two_hands_on_one_link(self) -> None:
        right = {"right": {"type": "device", "channel": 1}}
        one = together(right | {"tie": link("hand", "right", 2000.0, 5.0)})
        apart = np.array([[1.0, -1.0], [-1.0, 1.0]])
        np.testing.assert_allclose(one.felt.k, 2167.8914017232 * apart, rtol=1e-9)
        np.testing.assert_allclose(one.felt.b, np.eye(2) + 1.9923820182 * apart, rtol=1e-9)
        np.testing.assert_allclose(one.desired.k, 2000.0 * apart, rtol=1e-9)
        np.testing.assert_allclose(one.static_stiffness, 2000.0 * apart, rtol=1e-9)
        assert one.own_motion is None


class TestWeight:
    """Worked out elsewhere with 50 digits."""

    @staticmethod
    def cup(**more: Any) -> Network:
        values: dict[str, Any] = {"rate": 4000.0, "delay": 1.0, "hold": "zoh", "sampling": "ideal"}
        values |= {"channel_mass": [0.4], "point_mass": [2.4], "stiffness": [800.0], "damping": [2.0]}
        lists = {"channel_friction": [1.0], "ends": [[0, 1]]} | values | more
        return Network(**{name: np.array(one) if isinstance(one, list) else one for name, one in lists.items()})

    @pytest.mark.parametrize(
        ("hand", "felt", "continuous"),
        [
            (50.0, 2.529150257, 2.528862),
            (150.0, 2.793588867, 2.793347),
            (300.0, 3.200173514, 3.199962),
            (1000.0, 5.184818350, 5.184560),
        ],
    )
    def test_of_a_heavy_cup(self, hand: float, felt: float, continuous: float) -> None:
        assert felt_mass(self.cup(), hand)[0] == pytest.approx(felt, rel=1e-9)
        assert continuous_mass(self.cup(), hand) == pytest.approx(continuous, rel=1e-6)

    def test_is_reported_of_a_scene_whose_masses_nothing_holds(self) -> None:
        modules = {"cup": mass(2.4), "touch": link("hand", "cup", 800.0, 2.0)}
        weight = together(modules, rate=4000, device={"mass": 0.4}).weight
        assert weight is not None
        assert (weight.mass, weight.felt) == pytest.approx((2.4, 3.200173514), rel=1e-9)
        assert weight.within_10_percent_hz == pytest.approx(0.88, abs=0.005)
        assert weight.to_simulate == pytest.approx(1.816, abs=5e-4)
        lighter = together(modules | {"cup": mass(weight.to_simulate)}, rate=4000, device={"mass": 0.4}).weight
        assert lighter is not None
        assert lighter.felt == pytest.approx(2.4, rel=2e-5)  # to the digits that are shown
        assert together(modules | {"hold": link("cup", "wall", 5.0, 0.0)}).weight is None


@pytest.mark.parametrize("seed", SEEDS)
def test_a_mass_without_weight_changes_nothing(seed: int) -> None:
    """A hand beside a stiff mote feels what it does without, by the formula of one hand."""
    draw = np.random.default_rng(seed)
    stiffness, damping = float(draw.uniform(100.0, 3000.0)), float(draw.uniform(0.0, 6.0))
    mote = {"mote": {"type": "cell", "mass": 1e-9, "stiffness": 1e-9}, "tie": link("hand", "mote", 1e-9, 0.0)}
    one = together({"touch": link("hand", "wall", stiffness, damping)} | mote)
    k, b = Configuration(mass=0.2, rate=1000.0, friction=1.0).equivalent(stiffness, damping)
    assert (one.felt.k[0, 0], one.felt.b[0, 0]) == pytest.approx((float(k), float(b)), rel=1e-8)


def poles_in(positions: NDArray[np.float64], most: int) -> NDArray[np.complex128]:
    """The poles of a sum of decaying swings, by the matrix pencil of these positions (Hua and Sarkar, 1990)."""
    rows = np.lib.stride_tricks.sliding_window_view(positions, most)[: positions.size - most + 1]
    basis, size, _ = np.linalg.svd(rows.T, full_matrices=False)
    basis = basis[:, : min(int((size > 1e-10 * size[0]).sum()), most - 2)]
    return np.linalg.eigvals(np.linalg.lstsq(basis[:-1], basis[1:], rcond=None)[0])


@pytest.mark.parametrize("seed", range(thorough.points(6, 15)))
def test_a_pair_is_stated_where_hands_move_as_on_it(seed: int, figures: Any) -> None:
    """In virtual time, after a flick of each hand. If one hand swings long enough to identify its pole by matrix
    pencils, the pole agrees too."""
    one = judged(seed)
    assert one is None or one.result in ("none", "right")
    if one is None or one.result == "none":
        return
    figures.most("a hand's way after a flick off by, rms", one.off)
    s = np.roots([one.scene.device.masses(1)[0], one.pair.b[0, 0], one.pair.k[0, 0]])[0] / one.scene.rate
    is_told = len(one.scene.modules) < 12  # of more motions the record tells too little
    if len(one.part.names) == 1 and abs(s.imag) > -s.real and is_told:
        seen = run_in_memory(flicked(one.scene, 1, 0), duration=1.5).position[5:, 0]
        off = min(float(np.abs(poles_in(seen, most) - np.exp(s)).min() / abs(s)) for most in (40, 120, 300))
        figures.most("a hand's own motion off by, relative", off)
        assert off < 1e-5


FREE = {"touch": link("hand", "ball", 77.9, 1.64), "ball": mass(0.0078)}
LIGHT = {"mass": 0.05, "friction": 2.0, "delay": 1}


def test_no_pair_is_stated_that_the_hand_does_not_follow() -> None:
    """The drift has a little less than nine tenths of its energy in the hand, so a pole of the delay would be paired:
    8089 N/m and 225 N·s/m, of which nothing is felt."""
    one = together(FREE, rate=2000, device=LIGHT)
    assert one.felt.reason == ANSWERS
    assert one.drift_damping == pytest.approx([2.0], rel=1e-9)


@pytest.mark.parametrize(
    ("more", "braked_by"),
    [
        ({}, 2.0),
        ({"brake": {"type": "damper", "between": ["ball", "wall"], "damping": 0.5}}, 2.5),
        ({"brake": {"type": "damper", "between": ["ball", "far"], "damping": 0.5}, "far": mass(0.1)}, 2.0),
        ({"own": {"type": "damper", "between": ["hand", "wall"], "damping": 1.0}}, 3.0),
        ({"other": {"type": "device", "channel": 1}, "tie": link("ball", "other", 500.0, 1.0)}, 4.0),
    ],
)
def test_a_hand_that_drifts_goes_as_far_as_predicted(more: dict[str, Any], braked_by: float) -> None:
    mock = {"quantum": 1e-11, "initial": {"velocity": 0.1 if "other" not in more else [0.1, 0.0]}}
    scene = scene_of(FREE | more, rate=2000, device=LIGHT, mock=mock)
    (one,) = predict(scene, with_margins=False).parts
    assert one.drift_damping == pytest.approx([braked_by] * len(one.names), rel=1e-9)
    way = run_in_memory(scene, duration=3.0).position[-1, : len(one.names)]
    assert way == pytest.approx(0.05 * 0.1 / one.drift_damping, rel=1e-5)
    held = predict(scene_of(FREE | more | {"hold": link("ball", "wall", 1.0, 0.0)}, rate=2000, device=LIGHT))
    assert np.isnan(held.parts[0].drift_damping).all()


def test_nothing_brakes_a_hand_without_friction() -> None:
    assert together(FREE, device=LIGHT | {"friction": 0.0}).drift_damping.tolist() == [0.0]
    bare = together({"touch": link("hand", "ball", 77.9, 0.0), "ball": mass(0.0078)}, device={"friction": 0.0})
    assert bare.drift_damping.tolist() == [0.0]
    beside = {"ball": mass(0.1), "hold": link("hand", "wall", 100.0, 0.0)}
    beside["brake"] = {"type": "damper", "between": ["hand", "ball"], "damping": 1.0}
    assert np.isnan(together(beside).drift_damping).all()  # the mass drifts, the hand does not


def test_what_a_hand_meets_where_no_motion_is_its_own() -> None:
    """Slowly, the free ball's weight: m ω² less than nothing of a spring; fast, the link alone."""
    one = together({"ball": mass(1.0), "touch": link("hand", "ball", 2000.0, 5.0)})
    (k,), _ = one.at_frequencies
    ball = -1.0 * (2.0 * np.pi * 2.0) ** 2
    assert k[0] == pytest.approx(1.0 / (1.0 / 2000.0 + 1.0 / ball), rel=0.02)
    assert k[2] > 2000.0
    assert one.static_stiffness[0, 0] == pytest.approx(0.0, abs=1e-9)


def test_a_steady_push_meets_the_soft_spring_behind_the_stiffest() -> None:
    chain = {"ball": mass(1.0), "touch": link("hand", "ball", 1e12, 5.0), "end": link("ball", "wall", 800.0, 5.0)}
    assert together(chain).static_stiffness[0, 0] == pytest.approx(800.0, rel=1e-6)
    assert isinstance(
        together(
            {"tie": link("hand", "m", 500.0, 1.0), "m": mass(0.02), "w": link("m", "wall", 500.0, 1.0)}
        ).own_motion,
        OwnMotion,
    )


def test_what_rounding_leaves_is_no_stiffness_and_no_damping() -> None:
    """Two hands that a damper alone joins, and one on an ideal spring in the middle of a sample."""
    brake = {"type": "damper", "between": ["hand", "right"], "damping": 3.0}
    one = together({"right": {"type": "device", "channel": 1}, "brake": brake}, device={"mass": [0.13, 0.7]})
    assert not one.felt.reason
    assert (one.felt.k.tolist(), one.desired.k.tolist()) == ([[0.0] * 2] * 2,) * 2
    for friction in np.random.default_rng(0).uniform(0.01, 3.0, 20).tolist():
        modules = {"touch": link("hand", "wall", 300.0, 0.0)}
        scene = scene_of(modules, device={"friction": 0.0, "mass": friction, "delay": 0, "hold": "impulse"})
        assert predict(scene, with_margins=False).parts[0].felt.b.tolist() == [[0.0]]
