"""Verdict, margins, modes and static stiffness behind a correction: those of the corrected loop with its observer."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from itertools import product
from typing import Any

import numpy as np
import pytest

from hapsim import measure, predict
from hapsim.cli.check import check_lines
from hapsim.prediction import Prediction
from hapsim.prediction.correction.kind import with_modules
from hapsim.prediction.first_help import first_help, ways_to_stability
from hapsim.prediction.linear import network_of, with_device
from hapsim.prediction.swings import NetworkVerdict
from hapsim.running.run import run_in_memory
from hapsim.scene import Scene
from hapsim.theory.network import poles_of
from tests import thorough
from tests.correction.test_correction_scenes import ON_A_MASS, link, scene_of

SPAN = {"from": 0.05, "to": 1.0}


def on_a_buffer(stiffness: float, damping: float = 5.0) -> Scene:
    return scene_of({"buffer": link(("hand", "wall"), stiffness, damping, "buffer")}, mass=SPAN, correction="adaptive")


def turns(is_stable: Callable[[float], bool], stable: float, unstable: float) -> float:
    """Value at which the verdict turns, by bisection."""
    assert is_stable(stable)
    assert not is_stable(unstable)
    while abs(unstable / stable - 1.0) > 1e-8:
        middle = 0.5 * (stable + unstable)
        stable, unstable = (middle, unstable) if is_stable(middle) else (stable, middle)
    return stable


def test_the_margin_of_a_contact_is_where_the_verdict_on_the_file_turns() -> None:
    """A contact that an adaptive correction leaves alone, for a hand heavier than its predictor assumes."""
    (margin,) = predict(on_a_buffer(1000.0)).margins
    verdict = turns(lambda K: predict(on_a_buffer(K), with_margins=False).stable, 1000.0, 20000.0)
    assert 1000.0 * margin.stiffness_factor == pytest.approx(verdict, rel=1e-6)


def test_what_is_advised_of_an_unstable_contact_makes_it_stable() -> None:
    """In the file, where the observer is made anew for another damping."""
    prediction = predict(on_a_buffer(10000.0))
    assert not prediction.stable
    stiffness, damping = first_help(prediction)
    assert (stiffness.what, damping.what) == ("stiffness", "damping")
    assert ways_to_stability(prediction) in " ".join(
        map(str, check_lines(prediction.scene, prediction, None, explain=True))
    )
    for scene, is_stable in (
        (on_a_buffer(10000.0 * stiffness.factor), True),
        (on_a_buffer(10000.0 * stiffness.factor**0.98), False),
        (on_a_buffer(10000.0, 5.0 * damping.factor), True),
        (on_a_buffer(10000.0, 5.0 * damping.factor**0.98), False),
    ):
        assert predict(scene, with_margins=False).stable is is_stable


def random_scene(seed: int) -> Scene:
    """A hand with a correction, on a spring, a contact, both, a mass behind a spring, or two tied hands."""
    draw = np.random.default_rng(seed)
    correction = str(draw.choice(["predictor", "adaptive", "poles"]))
    mass = float(10.0 ** draw.uniform(-1.5, 0.0))
    is_span = correction == "adaptive" or draw.random() < 0.3
    K, B = float(10.0 ** draw.uniform(2.0, 4.0)), float(10.0 ** draw.uniform(-0.5, 1.2))
    touch, buffer = link(("hand", "wall"), K, B), link(("hand", "wall"), 0.7 * K, B, "buffer")
    behind = {
        "touch": link(("hand", "m"), K, B),
        "m": {"type": "mass", "mass": float(draw.uniform(0.01, 0.3))},
        "back": link(("m", "wall"), 0.5 * K, 0.3 * B),
    }
    tied = {"other": {"type": "device", "channel": 1}, "touch": touch, "tie": link(("hand", "other"), 0.3 * K, B)}
    kinds: list[dict[str, Any]] = [
        {"touch": touch},
        {"buffer": buffer},
        {"touch": touch, "buffer": buffer},
        behind,
        tied,
    ]
    return scene_of(
        kinds[int(draw.integers(len(kinds)))],
        mass={"from": mass, "to": mass * float(draw.uniform(1.5, 6.0))} if is_span else mass,
        friction=float(draw.uniform(0.1, 3.0)),
        delay=float(draw.choice([0.6, 1.0, 2.0])),
        correction=correction,
    )


def of_network(prediction: Prediction, name: str, quantity: str, factor: float) -> bool:
    """Verdict on the loop, in every region, with one link's simulated value times the factor, and the rest as it is."""
    values = np.array(getattr(prediction.network, quantity))
    values[[*prediction.scene.links].index(name)] *= factor
    network = replace(prediction.network, **{quantity: values})
    held = [one for regions in prediction.regions.values() for one in regions if one.kind == "held"]
    more = ((one.felt, (factor - 1.0) * getattr(one.linear[name], quantity)) for one in held)
    in_regions = (replace(felt, **{quantity: getattr(felt, quantity) + added}).stable for felt, added in more)
    return NetworkVerdict(network, prediction.points).solved.solution.is_stable and all(in_regions)


def of_hand(prediction: Prediction, _name: str, quantity: str, factor: float) -> bool:
    """The same of a hand that has this link alone."""
    (felt,) = prediction.felt
    return replace(felt, **{quantity: factor * getattr(felt, quantity)}).stable


def of_file(prediction: Prediction, name: str, quantity: str, factor: float) -> bool:
    """The same of a file without a correction that has the simulated values, of which one is changed."""
    assert prediction.rendering is not None
    scene = with_device(prediction.rendering.scene, correction="none")
    module = scene.modules[name]
    changed = module.model_copy(update={quantity: factor * getattr(module, quantity)})
    return predict(with_modules(scene, {name: changed}), with_margins=False).stable


@pytest.mark.parametrize("seed", range(thorough.points(2, 6)))
def test_the_verdict_turns_at_the_stated_margins(seed: int, figures: Any) -> None:
    """The verdict on the network, on a hand's own loop, and on a file with the values that poles simulate."""
    prediction = predict(random_scene(seed))
    verdicts = [of_network, *[of_hand] * (len(prediction.scene.links) == len(prediction.felt) == 1)]
    verdicts += [of_file] * (prediction.scene.device.correction == "poles")
    for one, verdict in product(prediction.margins if prediction.stable else (), verdicts):
        for quantity, factor in (("stiffness", one.stiffness_factor), ("damping", one.damping_factor)):
            if math.isfinite(factor):
                found = turns(partial(verdict, prediction, one.name, quantity), 1.0, 1.001 * factor)
                figures.most("margin of a corrected loop off by, relative", abs(found / factor - 1.0))
                assert found == pytest.approx(factor, rel=1e-6)


@pytest.mark.parametrize("factor", [0.8, 1.3])
def test_a_hand_of_another_mass_moves_masses_as_the_network_with_its_observer_predicts(factor: float) -> None:
    """Measured on the mock, which knows nothing of the prediction."""
    scene = scene_of(ON_A_MASS, correction="predictor", mock={"mass": 0.2 * factor})
    prediction = predict(scene, with_margins=False)
    network = replace(prediction.network, channel_mass=factor * prediction.network.channel_mass)
    poles = poles_of(network).astype(complex)
    poles = np.log(poles[np.abs(poles) > 0.1]) * 1000.0
    slowest = max((one for one in poles if one.imag > 1.0), key=lambda one: one.real)
    felt = measure(scene)
    assert felt.frequency_hz == pytest.approx(abs(slowest) / (2 * np.pi), rel=1e-6)
    assert felt.damping_ratio == pytest.approx(-slowest.real / abs(slowest), rel=1e-4)


TIED = {
    "other": {"type": "device", "channel": 1},
    "touch": link(("hand", "wall"), 500.0, 3.0),
    "tie": link(("hand", "other"), 300.0, 2.0),
    "back": link(("other", "wall"), 200.0, 3.0),
}


def test_hands_that_each_other_moves_feel_what_they_feel_without_delay() -> None:
    """The observers' poles move nothing: the others are those of a network that senses velocities, without delay."""
    (part,) = (prediction := predict(scene_of(TIED, correction="predictor"), with_margins=False)).parts
    assert not part.felt.reason
    np.testing.assert_allclose(part.felt.k, part.desired.k, rtol=0.05)
    seen = network_of(prediction._seen, prediction._linear)[0]
    assert seen.delay == 0.0
    *observers, a, b, c, d = sorted(poles_of(prediction.network), key=abs)
    np.testing.assert_allclose(np.sort_complex([a, b, c, d]), np.sort_complex(poles_of(seen))[-4:], atol=1e-10)
    assert max(map(abs, observers)) == pytest.approx(0.5, abs=1e-6)


def test_steady_pushes_on_tied_hands_meet_the_static_stiffness() -> None:
    """On the mock, each pushed by 1 N."""
    mock = {"initial": {"velocity": 0.0}, "hand": {"force": 1.0}}
    scene = scene_of(TIED, correction="predictor", friction=6.0, mock=mock)
    (part,) = predict(scene, with_margins=False).parts
    trace = run_in_memory(scene, duration=3.0)
    moved = trace.position_counts[-1] * np.array(trace.position_scale)
    np.testing.assert_allclose(part.static_stiffness @ moved, [1.0, 1.0], rtol=1e-6)


def test_of_a_predictor_for_another_mass_no_pair_is_stated() -> None:
    """The least mass of the span is the predictor's: the observer's poles are no longer apart."""
    both = {"touch": link(("hand", "wall"), 500.0, 3.0), "buffer": link(("hand", "wall"), 300.0, 3.0, "buffer")}
    (part,) = predict(scene_of(both, correction="predictor", mass={"from": 0.1, "to": 0.4}), with_margins=False).parts
    assert "another mass" in part.felt.reason
    assert np.isnan(part.felt.k).all()


def test_no_passivity_is_claimed_behind_a_predictor() -> None:
    """Neither of a spring nor of a contact, whose damper differentiates positions."""
    for of in ("viscoelastic", "buffer"):
        scene = scene_of({"touch": link(("hand", "wall"), 300.0, 0.1, of)}, correction="predictor", friction=3.0)
        (part,) = predict(scene, with_margins=False).parts
        assert part.passive is None
        assert "predictor" in part.any_hand.not_derived
        assert math.isnan(part.needed_friction[0])


def test_an_ordinary_hand_that_a_predictor_does_not_assume_may_shake() -> None:
    """A hand beside the declared one is a mismatch of the predictor, so it is judged with its observer."""
    scene = scene_of({"touch": link(("hand", "wall"), 30000.0, 60.0)}, correction="predictor", mass=0.05)
    (part,) = predict(scene, with_margins=False).parts
    worst = part.any_hand.worst_hand((0.0, 1.0), (0.0, 0.0))
    assert worst is not None
    (felt,) = predict(scene, with_margins=False).felt
    assert worst.spectral_radius == pytest.approx(felt.with_mass(0.05 + worst.masses[0]).spectral_radius, rel=1e-9)
