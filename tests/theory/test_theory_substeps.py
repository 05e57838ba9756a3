"""Several steps of a scene in a sample: against known figures, the formula of one hand, and scenes at a fine rate."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
import pytest

from hapsim.prediction import predict
from hapsim.scene import Scene
from hapsim.theory import Configuration, Network, NotWorkedOutError, sample, solve
from hapsim.theory.hand.configuration import stiffest_passive, stiffest_stable
from hapsim.theory.interface import damper_named, delay_and_hold
from hapsim.theory.network import large_loop, large_modes
from hapsim.theory.network.impedance import loop_impedance
from hapsim.theory.network.large_loop import sparse_transition
from hapsim.theory.schemes import SCHEMES
from tests.networks import network_of
from tests.transitions import apart, transition

RATE, MASS = 1000.0, 0.2
SOFT = Configuration(mass=MASS, rate=RATE, friction=1.0)


def network(substeps: int, decimation: str = "last", **changed: Any) -> Network:
    """A hand on 10 g, which hangs on the ground."""
    links = {"point_mass": [0.01], "ends": [[0, 1], [1, -1]], "stiffness": [2000.0, 3000.0], "damping": [5.0, 0.5]}
    return network_of(**{"substeps": substeps, "decimation": decimation} | links | changed)


def felt(poles: np.ndarray) -> tuple[float, float]:
    """k and b of the two slowest poles."""
    s = np.log(poles[:2]) * RATE
    return float((MASS * s[0] * s[1]).real), float((-MASS * (s[0] + s[1])).real)


def lag(substeps: int) -> float:
    return (substeps - 1) / (2 * substeps)


WALL = {
    ("last", 1): (2080.439, 3.0208),
    ("last", 2): (2080.439, 3.0208),
    ("last", 48): (2080.439, 3.0208),
    ("mean", 2): (2069.363, 2.4993),
    ("mean", 8): (2061.173, 2.1117),
    ("mean", 48): (2058.915, 2.0046),
}


@pytest.mark.parametrize(("decimation", "substeps"), WALL)
def test_a_wall_through_substeps(decimation: str, substeps: int) -> None:
    expected = [
        pytest.approx(value, abs=half) for value, half in zip(WALL[decimation, substeps], (6e-4, 6e-5), strict=True)
    ]
    alone = network(substeps, decimation, point_mass=[], ends=[[0, -1]], stiffness=[2000.0], damping=[5.0])
    assert list(felt(solve(alone).poles)) == expected
    formula = replace(SOFT, spring_lag=lag(substeps) if decimation == "mean" else 0.0)
    assert list(map(float, formula.equivalent(2000.0, 5.0))) == expected
    modules = {"hand": {"type": "device", "channel": 0}, "wall": {"type": "ground"}}
    modules["touch"] = {"type": "viscoelastic", "between": ["hand", "wall"], "stiffness": 2000, "damping": 5}
    prediction = predict(scene(modules, substeps, decimation))
    assert [prediction.k, prediction.b] == expected
    assert prediction.margins[0].damping_factor == pytest.approx(bisected(alone, 0, "damping"), rel=1e-7)
    assert prediction.margins[0].stiffness_factor == pytest.approx(bisected(alone, 0, "stiffness"), rel=1e-7)


def scene(modules: dict[str, Any], substeps: int, decimation: str, **device: Any) -> Scene:
    of_device = {"mass": MASS, "friction": 1.0, "clock": "lockstep", "decimation": decimation} | device
    return Scene.model_validate(
        {"version": 1, "rate": RATE, "substeps": substeps, "device": of_device, "modules": modules}
    )


def bisected(one: Network, link: int, name: str) -> float:
    """The factor from which on the loop is unstable, above 1."""

    def is_stable(factor: float) -> bool:
        values = getattr(one, name).copy()
        values[link] *= factor
        return bool(np.abs(np.linalg.eigvals(transition(replace(one, **{name: values})))).max() <= 1.0 + 1e-10)

    near, far = 1.0, 1.1
    while is_stable(far):
        near, far = far, far * 1.1
    while far / near - 1.0 > 1e-9:
        near, far = (middle, far) if is_stable(middle := math.sqrt(near * far)) else (near, middle)
    return near


class TestSpringLag:
    """`Configuration` with the lag of a mean against the network's poles."""

    @pytest.fixture(params=[(2, "zoh", 1.0), (16, "impulse", 0.37), (48, "zoh", 0.0), (8, "ramp", 2.0)], ids=str)
    def both(self, request: pytest.FixtureRequest) -> tuple[Configuration, Any]:
        substeps, hold, delay = request.param
        one = replace(SOFT, hold=hold, delay=delay, spring_lag=lag(substeps), stiffness=40.0)

        def poles(K: float, B: float) -> np.ndarray:
            device = {"hold": hold, "delay": delay, "channel_stiffness": [40.0]}
            return solve(
                network(substeps, "mean", point_mass=[], ends=[[0, -1]], stiffness=[K], damping=[B], **device)
            ).poles

        return one, poles

    def test_poles_and_what_is_felt(self, both: tuple[Configuration, Any]) -> None:
        one, poles = both
        for K, B in ((2000.0, 5.0), (9000.0, 20.0), (300.0, 60.0), (-200.0, 3.0)):
            assert apart(one.poles(K, B), poles(K, B)) < 1e-9
        k, b = one.equivalent(2000.0, 5.0)
        assert felt(poles(2000.0, 5.0)) == (pytest.approx(k, rel=1e-9), pytest.approx(b, rel=1e-7))
        np.testing.assert_allclose(one.simulated(k, b), (2000.0, 5.0), rtol=1e-9)
        np.testing.assert_allclose(np.roots(one.characteristic(2000.0, 5.0))[0], one.poles(2000.0, 5.0)[0], rtol=1e-9)

    def test_where_it_is_stable(self, both: tuple[Configuration, Any]) -> None:
        one, poles = both
        for least, most, at in (
            (*one.stable_stiffness(8.0), lambda K: poles(K, 8.0)),
            (*one.stable_damping(900.0), lambda B: poles(900.0, B)),
        ):
            assert least < most
            for edge, inside in ((least, 1.0), (most, -1.0)):
                moved = 1e-6 * max(abs(edge), 1e-3 * (most - least))
                for sign in (1.0, -1.0):
                    radius = np.abs(at(edge + sign * inside * moved)).max()
                    assert (radius < 1.0) == (sign > 0.0), (edge, radius)
        at_limit = [float(value) for value in one.stability_limit(9.0)]
        if np.isfinite(at_limit).all():
            assert np.abs(poles(*at_limit)).max() == pytest.approx(1.0, abs=1e-9)

    def test_where_the_map_folds(self, both: tuple[Configuration, Any]) -> None:
        one, poles = both
        K, B, _, _ = (np.asarray(value) for value in one.fold(np.geomspace(20.0, 2000.0, 60)))
        at = np.flatnonzero(np.isfinite(K))
        for i in at[:: max(1, at.size // 4)].tolist():
            slowest = np.sort(np.abs(poles(float(K[i]), float(B[i]))))[::-1]
            assert slowest[1] == pytest.approx(slowest[2], rel=1e-5)  # a double pole, which rounding splits by its root

    def test_impedance_and_passivity(self, both: tuple[Configuration, Any]) -> None:
        one, _ = both
        f = np.array([3.0, 40.0, 300.0])
        substeps = round(1.0 / (1.0 - 2.0 * one.spring_lag))
        alone = network(
            substeps,
            "mean",
            point_mass=[],
            ends=[[0, -1]],
            stiffness=[2000.0],
            damping=[5.0],
            delay=one.delay,
            hold=one.hold,
            channel_stiffness=[40.0],
        )
        rendered = one.impedance(2000.0, 5.0, f) - one.friction - one.stiffness / (2j * np.pi * f)
        np.testing.assert_allclose(loop_impedance(alone, f).rendered[:, 0, 0], rendered, rtol=1e-7)
        z = np.exp(2j * np.pi * f / RATE)
        position = np.array([1.0 - (substeps - j) / substeps * (1.0 - 1.0 / z) for j in range(1, substeps + 1)])
        force = 2000.0 * position.mean(axis=0) + 5.0 * RATE * (1.0 - 1.0 / z)
        through = delay_and_hold(2.0 * np.pi * f / RATE, one.delay, one.hold, one.sampling)
        np.testing.assert_allclose(rendered, force * through / (2j * np.pi * f), rtol=1e-12)
        if one.hold == "zoh":
            shifted = replace(one, spring_lag=0.0).needed_friction(2000.0, 5.0 - 2000.0 * one.spring_lag / RATE)
            assert one.needed_friction(2000.0, 5.0) == pytest.approx(float(shifted), rel=1e-12)
            wall = stiffest_passive(one)
            assert one.needed_friction(*wall) == pytest.approx(one.friction, rel=1e-6)
        late, last = stiffest_stable(one), stiffest_stable(replace(one, spring_lag=0.0))
        assert late.stiffness == pytest.approx(last.stiffness, rel=1e-9)
        assert late.damping == pytest.approx(last.damping + last.stiffness * one.spring_lag / RATE, rel=1e-3)
        K = 0.01
        slope = (one.equivalent(K, 0.0)[1] - one.equivalent(0.0, 0.0)[1]) / K
        limit = one.linear_stiffness_limit(0.0)
        assert float(limit) == pytest.approx(-one.friction / float(slope), rel=0.02)


def string(substeps: int, masses: int = 30, **changed: Any) -> Network:
    """At 440 Hz; a hand beside it on a wall."""
    mass = 1e-3 / masses
    stiffness = mass * (2.0 * math.pi * 440.0 / (2.0 * math.sin(0.5 * math.pi / (masses + 1)))) ** 2
    ends = [*pairwise([-1, *range(1, masses + 1), -1]), (0, -1)]
    arguments = {
        "point_mass": [mass] * masses,
        "ends": ends,
        "stiffness": [*[stiffness] * (masses + 1), 500.0],
        "damping": [*[1e-5] * (masses + 1), 2.0],
    }
    return network(substeps, **(arguments | changed))


@pytest.mark.parametrize("scheme", SCHEMES)
def test_the_pitch_of_a_string_above_half_the_device_s_rate(scheme: str) -> None:
    coarse, fine = string(48, scheme=scheme), string(1, scheme=scheme, rate=48.0 * RATE)
    modes = {mode.frequency_hz: mode for mode in solve(coarse).modes if mode.participation[0] < 0.5}
    expected = [mode for mode in solve(fine).modes if mode.participation[0] < 0.5 and mode.pole.imag]
    assert len(expected) == 30
    for one in expected:
        found = modes[min(modes, key=lambda hz: abs(hz - one.frequency_hz))]
        assert found.frequency_hz == pytest.approx(one.frequency_hz, rel=1e-9)
        assert found.damping_ratio == pytest.approx(one.damping_ratio, rel=1e-4, abs=1e-12)
    assert min(modes) == pytest.approx(440.0, rel=1e-3)


def held_string(scheme: str, substeps: int, masses: int, decimation: str = "mean") -> Network:
    plain = string(substeps, masses, scheme=scheme, decimation=decimation)
    return replace(
        plain,
        ends=[*plain.ends.tolist(), [0, 5], [7, 0]],
        stiffness=[*plain.stiffness, 60.0, 20.0],
        damping=[*plain.damping, 0.01, 0.02],
        damper=[*plain.damper, damper_named("filtered", 90.0, RATE * substeps), damper_named("sensed", None, RATE)],
    )


@pytest.mark.parametrize("scheme", SCHEMES)
def test_an_operator_with_substeps_is_the_transition(scheme: str) -> None:
    one = held_string(scheme, 36, 12)
    operator, expected = sparse_transition(one), transition(one)
    np.testing.assert_allclose(
        operator @ np.eye(operator.size), expected, rtol=0.0, atol=1e-12 * np.abs(expected).max()
    )
    motion = np.random.default_rng(3).standard_normal(operator.size)
    for shift in (0.9 + 0.3j, 0.8):
        inverse = operator.inverse(shift)
        assert inverse is not None
        found = inverse(motion + 0j if np.imag(shift) else motion)
        assert np.abs(expected @ found - shift * found - motion).max() < 1e-8 * np.abs(expected).max()


def test_a_large_string_with_substeps_has_the_poles_of_its_whole_transition(monkeypatch: pytest.MonkeyPatch) -> None:
    one = held_string("cordis", 40, 30)
    every = solve(one)
    monkeypatch.setattr(sample, "LARGE", 50)
    monkeypatch.setattr(large_modes, "MOST_STEPS", 3000)
    some = solve(one)
    assert some.poles.size > 30
    assert np.abs(some.poles[:, None] - every.poles).min(axis=1).max() < 1e-8
    pitches = [mode.frequency_hz for mode in every.modes if mode.pole.imag]
    for mode in some.modes:
        if mode.pole.imag:
            assert np.abs(np.array(pitches) / mode.frequency_hz - 1.0).min() < 1e-9
    assert {round(mode.frequency_hz / 440.0) for mode in some.modes} >= set(range(1, 9))
    monkeypatch.setattr(large_loop, "MOST_INVERSE", 1000)
    with pytest.raises(NotWorkedOutError, match="take too long"):
        solve(one)


def test_where_it_takes_too_long_the_pitch_is_predicted_and_the_rest_is_reported(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    gut = {"type": "string", "masses": 40, "mass": 1e-5, "stiffness": 1000, "damping": 1e-5}
    pull = {"type": "viscoelastic", "between": ["hand", "gut.8"], "stiffness": 20, "damping": 0.01}
    plucked = scene(MODULES | {"gut": gut, "pull": pull}, 48, "last")
    exact = predict(plucked, with_margins=False)
    monkeypatch.setattr(sample, "LARGE", 50)
    monkeypatch.setattr(large_modes, "MOST_STEPS", 3000)
    monkeypatch.setattr(large_loop, "MOST_INVERSE", 1000)
    taken = predict(plucked, with_margins=False)
    assert exact.by_its_scheme
    assert not taken.by_its_scheme
    assert "48 substeps of this many masses take too long" in taken.assumptions[-1]
    pitches = [min(mode.frequency_hz for mode in one.modes if mode.frequency_hz > 50.0) for one in (exact, taken)]
    assert pitches[1] == pytest.approx(pitches[0], rel=1e-3)


MODULES: dict[str, Any] = {
    "hand": {"type": "device", "channel": 0},
    "wall": {"type": "ground"},
    "touch": {"type": "viscoelastic", "between": ["hand", "wall"], "stiffness": 2000, "damping": 5},
}


def with_damper(**damper: Any) -> dict[str, Any]:
    return MODULES | {"touch": MODULES["touch"] | damper}


def test_a_mean_of_a_damper_that_is_not_backward_has_no_formula_of_one_hand() -> None:
    for damper in ({"damper": "filtered", "cutoff": 100}, {"damper": "sensed"}):
        last = predict(scene(with_damper(**damper), 8, "last"), with_margins=False)
        assert last.k == pytest.approx(predict(scene(with_damper(**damper), 1, "last"), with_margins=False).k)
        mean = predict(scene(with_damper(**damper), 8, "mean"), with_margins=False)
        assert not mean.felt
        assert "mean force of its substeps" in mean.coupled["hand"]
        assert mean.stable
        assert felt(np.array(mean.poles))[1] < last.b


@pytest.mark.parametrize("decimation", ["last", "mean"])
def test_poles_are_placed_through_substeps(decimation: str) -> None:
    corrected = predict(scene(MODULES, 8, decimation, correction="poles"))
    assert (corrected.k, corrected.b) == (pytest.approx(2000.0, rel=1e-9), pytest.approx(6.0, rel=1e-9))


def test_a_predictor_answers_the_last_substep() -> None:
    predicted = predict(scene(MODULES, 8, "last", correction="predictor"))
    assert (predicted.k, predicted.b) == (pytest.approx(2000.0, rel=1e-9), pytest.approx(6.0, rel=1e-9))
    with pytest.raises(Exception, match="decimation: found mean with correction: predictor"):
        scene(MODULES, 8, "mean", correction="predictor")


def test_a_steady_push_does_not_notice_the_mean() -> None:
    from hapsim.prediction import robustness_of

    last, mean = (predict(scene(MODULES, 8, name)).felt[0] for name in ("last", "mean"))
    assert robustness_of(mean).steady_stiffness == pytest.approx(robustness_of(last).steady_stiffness, rel=1e-12)
