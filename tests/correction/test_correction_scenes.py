"""Corrections of whole scenes: hands that move masses, contacts, what cannot be had, and what is left as it is."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest

from hapsim import measure, predict
from hapsim.errors import SceneError
from hapsim.prediction import warnings_about
from hapsim.prediction.correction import rendered
from hapsim.running.run import run_in_memory
from hapsim.scene import Scene, parse_scene
from tests.one_hand import document_of


def scene_of(modules: dict[str, Any], *, mock: dict[str, Any] | None = None, **device: Any) -> Scene:
    start = {"initial": {"velocity": 0.1}, "quantum": 1e-10} | (mock or {})
    return parse_scene(json.dumps(document_of(modules, device={"force_limit": 1000.0} | device, mock=start)))


def link(between: tuple[str, str], stiffness: float, damping: float, kind: str = "viscoelastic") -> dict[str, Any]:
    return {"type": kind, "between": between, "stiffness": stiffness, "damping": damping}


ON_A_MASS = {
    "m": {"type": "mass", "mass": 0.05},
    "touch": link(("hand", "m"), 3000.0, 3.0),
    "back": link(("m", "wall"), 1000.0, 1.0),
}


@pytest.mark.parametrize("correction", ["poles", "predictor"])
@pytest.mark.parametrize("delay", [1.0, 2.0])
def test_the_slowest_mode_of_a_hand_on_a_mass_is_the_continuous_scenes(correction: str, delay: float) -> None:
    """Worked out here once more: two masses, two springs, in continuous time."""
    K = np.array([[3000.0, -3000.0], [-3000.0, 4000.0]])
    Z = np.array([[4.0, -3.0], [-3.0, 4.0]])
    inverse = np.diag([1 / 0.2, 1 / 0.05])
    step = np.block([[np.zeros((2, 2)), np.eye(2)], [-inverse @ K, -inverse @ Z]])
    slowest = max(np.linalg.eigvals(step), key=lambda root: (root.real, root.imag))
    scene = scene_of(ON_A_MASS, correction=correction, delay=delay)
    felt = measure(scene)
    assert felt.frequency_hz == pytest.approx(abs(slowest) / (2 * np.pi), rel=1e-6)
    assert felt.damping_ratio == pytest.approx(-slowest.real / abs(slowest), rel=1e-5)
    prediction = predict(scene, with_margins=False)
    assert prediction.desired_modes[0].root == pytest.approx(slowest, rel=1e-9)
    assert prediction.stable


def test_two_hands_on_one_mass_come_nearest_and_stay_stable() -> None:
    """The correction stabilizes a scene that is unstable without one."""
    modules = ON_A_MASS | {
        "other": {"type": "device", "channel": 1},
        "back": link(("m", "other"), 1000.0, 1.0),
        "held": {"type": "spring", "between": ("other", "wall"), "stiffness": 500.0},
    }
    assert not predict(scene_of(modules), with_margins=False).stable
    for correction in ("poles", "predictor"):
        prediction = predict(scene_of(modules, correction=correction), with_margins=False)
        assert prediction.stable
        for found, wanted in zip(prediction.modes, prediction.desired_modes[:2], strict=False):
            assert found.frequency_hz == pytest.approx(wanted.frequency_hz, rel=0.01)


@pytest.mark.thorough(keep=1)
@pytest.mark.parametrize(("least", "told"), [(0.15, "stable with the least and the greatest mass"), (0.01, "unstable")])
def test_of_a_hand_that_moves_a_mass_the_ends_of_its_span_are_tried(least: float, told: str) -> None:
    scene = scene_of(ON_A_MASS, correction="poles", mass={"from": least, "to": 0.3})
    (note,) = rendered(scene).notes
    assert told in note
    light = scene_of(ON_A_MASS, correction="poles", mass=float(np.sqrt(0.3 * least)))
    (port,) = rendered(light).ports  # the middle of the span: what is given to the links
    K, B = port.rendered
    modules = ON_A_MASS | {"touch": link(("hand", "m"), K, B)}
    assert predict(scene_of(modules, mass=least), with_margins=False).stable == ("unstable" not in told)


@pytest.mark.thorough(keep=1)
@pytest.mark.parametrize(("least", "told"), [(0.1, "stable with the least and the greatest mass"), (0.01, "unstable")])
def test_of_a_hand_that_moves_a_mass_no_estimate_follows_the_mass(least: float, told: str) -> None:
    """So a predictor is tried at the ends of the span as it is made for the middle, on the mock, too."""
    scene = scene_of(ON_A_MASS, correction="adaptive", mass={"from": least, "to": 0.4})
    (note,) = rendered(scene).notes
    assert "no estimate follows" in note
    assert told in note
    mock = {"mass": least, "initial": {"velocity": 1e-3}}
    of_middle = scene_of(ON_A_MASS, correction="predictor", mass=scene.device.masses(1)[0], mock=mock)
    way = run_in_memory(of_middle, duration=0.06).position_counts.astype(float)
    assert (np.ptp(way[-20:]) > 10.0 * np.ptp(way[:20])) == (told == "unstable")


@pytest.mark.parametrize("correction", ["poles", "predictor"])
def test_a_contact_is_felt_as_it_is_while_it_is_touched(correction: str) -> None:
    """A spring presses the hand against it: k and b are the sum of both."""
    modules = {
        "below": {"type": "ground", "position": -0.02},
        "press": link(("hand", "below"), 2000.0, 4.0),
        "hit": link(("hand", "wall"), 6000.0, 10.0, "buffer") | {"distance": 0.0},
    }
    pressed = {"initial": {"position": -0.005, "velocity": 0.02}}
    felt = measure(scene_of(modules, correction=correction, mock=pressed))
    plain = measure(scene_of(modules, mock=pressed))
    # The contact's damper takes differences of positions even where the other dampers get velocities: approximate then.
    exact = correction == "poles"
    assert felt.k == pytest.approx(8000.0, rel=1e-5 if exact else 0.05)
    assert felt.b == pytest.approx(15.0, rel=1e-4 if exact else 0.15)
    assert plain.b < 9.0


def test_what_is_no_spring_is_left_as_it_is_and_reported() -> None:
    rubs = {"type": "friction", "between": ("hand", "wall"), "force": 1.0, "stiffness": 500.0}
    scene = scene_of({"touch": link(("hand", "wall"), 2000.0, 5.0), "rubs": rubs}, correction="poles")
    rendering = rendered(scene)
    assert rendering.scene.modules["rubs"] == scene.modules["rubs"]
    assert [note for note in rendering.notes if note.startswith("rubs is not corrected")]


def test_what_cannot_be_had_is_reported_with_what_would_reach_it() -> None:
    """Each remedy is tried: with it the hand feels what is desired, and a little short of it it does not."""
    stiff = {"touch": link(("hand", "wall"), 100000.0, 150.0)}
    (wanted,) = predict(scene_of(stiff, correction="poles"), with_margins=False).desired
    assert not wanted.reached
    remedies = wanted.remedies
    assert remedies is not None
    scene = scene_of(stiff, correction="poles")
    of_force_limit, warning = warnings_about(scene, predict(scene, with_margins=False))
    assert of_force_limit.startswith("device.force_limit: found 1000 N")
    assert "does not reach k = 100000 N/m, b = 151 N·s/m at hand" in warning
    assert remedies.predictor
    assert predict(scene_of(stiff, correction="predictor"), with_margins=False).desired[0].reached

    def reached(rate: float = 1000.0, damping: float = 150.0, **device: Any) -> bool:
        scene = scene_of({"touch": link(("hand", "wall"), 100000.0, damping)}, correction="poles", **device)
        scene = scene.model_copy(update={"rate": rate})
        return predict(scene, with_margins=False).desired[0].reached

    assert remedies.rate_hz is not None
    assert reached(rate=remedies.rate_hz * 1.001)
    assert not reached(rate=remedies.rate_hz * 0.999)
    assert remedies.delay_samples is not None
    assert reached(delay=remedies.delay_samples * 0.999)
    assert not reached(delay=remedies.delay_samples * 1.001)
    assert remedies.friction is not None
    for factor in (1.001, 0.999):
        friction = remedies.friction * factor
        assert reached(friction=friction, damping=151.0 - friction) == (factor > 1.0)


def test_the_nearest_is_no_farther_than_its_neighbours() -> None:
    scene = scene_of({"touch": link(("hand", "wall"), 100000.0, 150.0)}, correction="poles")
    (port,) = rendered(scene).ports
    k, b = port.desired
    K, B = port.rendered

    def error(K: float, B: float) -> float:
        felt = port.declared.equivalent(K, B)
        return float(max(abs(felt[0] - k) / k, abs(felt[1] - b) / b))

    here = error(K, B)
    around = [error(K * x, B * y) for x in (0.98, 1.0, 1.02) for y in (0.98, 1.0, 1.02)]
    assert here <= np.nanmin(around) * 1.005


def test_the_masses_at_which_it_is_stable_are_where_it_turns_unstable() -> None:
    scene = scene_of({"touch": link(("hand", "wall"), 20000.0, 40.0)}, correction="predictor")
    (wanted,) = predict(scene, with_margins=False).desired
    least, most = wanted.stable_masses
    assert 0.05 < least < 0.2 < most
    for factor, grows in ((1.02, False), (0.98, True)):
        felt = measure(
            scene_of(
                {"touch": link(("hand", "wall"), 20000.0, 40.0)},
                correction="predictor",
                mock={"mass": least * factor, "initial": {"velocity": 1e-3}},
                force_limit=1e6,
            ),
            duration=0.4,
        )
        assert (abs(felt.poles[0]) > 1.0) == grows


def test_an_adaptive_correction_needs_a_span() -> None:
    with pytest.raises(SceneError, match=r"write device\.mass: \{from"):
        scene_of({"touch": link(("hand", "wall"), 2000.0, 5.0)}, correction="adaptive")
