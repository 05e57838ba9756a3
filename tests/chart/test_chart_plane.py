"""The K,B plane: every point drawn is one that the theory stands for, and nothing is drawn where it says nothing."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hapsim.chart import plane_curves as curves
from hapsim.chart.figure import figure_to, legend_below
from hapsim.chart.hand import Hand
from hapsim.chart.plane import Plane, plane
from hapsim.chart.plane_curves import Curve, round_values, scale_of, stable_region, view_of
from hapsim.errors import UsageError
from hapsim.number_format import short
from hapsim.theory import Configuration
from hapsim.units import LINEAR, Units, Written, complete

CASES: dict[str, dict[str, Any]] = {
    "6.1": {"hold": "impulse", "delay": 0.0},
    "6.2": {"hold": "impulse", "delay": 1.0},
    "6.3": {"hold": "impulse", "delay": 1.0, "friction": 0.5},
    "zoh": {"delay": 0.37, "friction": 0.2, "sampling": "average"},
    "sensed": {"delay": 0.0, "friction": 0.2, "damper": "sensed"},
    "filtered": {"delay": 1.0, "stiffness": 0.02, "damper": "filtered", "cutoff": 0.1},
}
DEVICE = Configuration(mass=0.2, rate=1000.0, friction=1.0)


def drawn(
    configuration: Configuration,
    K: float = math.nan,
    B: float = math.nan,
    *,
    masses: tuple[float, ...] = (),
    normalised: bool = False,
    total: bool = False,
    **view: Any,
) -> Plane:
    """A plane, in SI units unless it is `normalised`."""
    hand = Hand("hand", None, configuration, K, B)
    hands = [hand.with_mass(mass) for mass in masses] or [hand]
    scale = scale_of(configuration, normalised=normalised, total=total)
    return plane(hands, view_of(hands, from_total=total, **view), scale)


@pytest.fixture(scope="module", params=CASES)
def case(request: pytest.FixtureRequest) -> tuple[Configuration, Plane]:
    configuration = Configuration(mass=1.0, rate=1.0, **CASES[request.param])
    return configuration, drawn(configuration, total=bool(configuration.friction))


def finite(curve: Curve) -> Any:
    return np.isfinite(curve.K) & np.isfinite(curve.B)


def simulated(data: Plane, curve: Curve) -> tuple[Any, Any]:
    """(K, B) in SI units of the points that are drawn."""
    there = finite(curve)
    return curve.K[there], curve.B[there] - data.scale.offset


@pytest.mark.thorough(keep=2)
def test_what_is_felt_on_a_curve_is_what_it_is_drawn_for(case: tuple[Configuration, Plane]) -> None:
    configuration, data = case
    seen = [curve for curve in data.iso if curve.is_seen]
    assert {curve.kind for curve in seen} == {"iso_k", "iso_b"}
    for curve in seen:
        k, b = configuration.equivalent(*simulated(data, curve))
        felt = k if curve.kind == "iso_k" else b
        # Where the faster pole is nearly zero, rounding decides what is felt of a given (K, B).
        decided = curve.b[finite(curve)] < 8.0
        assert np.count_nonzero(decided) > 10 or curve.value > 8.0
        np.testing.assert_allclose(felt[decided], curve.value, rtol=1e-5, atol=1e-9)


def test_on_the_stability_limit_a_pole_lies_on_the_unit_circle(case: tuple[Configuration, Plane]) -> None:
    configuration, data = case
    K, B = simulated(data, data.boundaries[0])
    assert K.size > 20
    np.testing.assert_allclose(configuration.spectral_radius(K, B), 1.0, atol=1e-6)


def test_no_line_leaps_over_what_means_nothing(case: tuple[Configuration, Plane]) -> None:
    configuration, data = case
    view = data.sheets[0].view
    for curve in (*data.iso, data.boundaries[0], *data.fold):
        steps = np.abs(np.diff(curve.K)) / view.K_to + np.abs(np.diff(curve.B)) / (view.B_to - view.B_from)
        assert np.nanmax(steps, initial=0.0) < 0.03
        K, B = simulated(data, curve)
        if curve.kind.startswith("iso"):
            between = 0.5 * (K[1:] + K[:-1]), 0.5 * (B[1:] + B[:-1])
            joined = (finite(curve)[1:] & finite(curve)[:-1])[np.flatnonzero(finite(curve))[:-1]]
            decided = (curve.b[finite(curve)] < 8.0)[1:]
            lost = joined & decided & ~configuration.dominant(*between)
            assert np.count_nonzero(lost) <= 1  # a corner of the region may lie between two points


def test_a_curve_that_is_broken_has_a_gap() -> None:
    configuration = Configuration(mass=1.0, rate=1.0, hold="impulse", delay=1.0)
    data = drawn(configuration)
    curve = next(curve for curve in data.iso if curve.kind == "iso_b" and curve.value == 0.5)
    # Below the fold and above it the same b is felt; in between no spring and damper is.
    broken = np.flatnonzero(~finite(curve))
    k = np.linspace(1e-3, 1.0, 400)
    assert np.isnan(configuration.simulated(k, 0.5)[0]).any()
    assert broken.size > 0


def test_the_ideal_grid_is_where_nothing_is_lost() -> None:
    data = drawn(Configuration(mass=1.0, rate=1.0, friction=0.2, stiffness=0.01), total=True)
    ideal = {(curve.kind, curve.value): curve for curve in data.ideal if curve.is_seen}
    assert ideal
    for (kind, value), curve in ideal.items():
        if kind == "ideal_k":
            np.testing.assert_allclose(curve.K, value - 0.01)
        else:
            np.testing.assert_allclose(curve.B, value)  # the axis shows B + b0


@pytest.mark.thorough(keep=3)
@pytest.mark.parametrize("delay", [0.0, 0.5, 1.0])
@pytest.mark.parametrize("total", [False, True])
def test_on_the_border_of_the_passive_walls_the_friction_just_suffices(delay: float, total: bool) -> None:
    configuration = Configuration(mass=0.2, rate=1000.0, friction=1.0, delay=delay)
    data = drawn(configuration, 300.0, 0.2, total=total)
    K, B = simulated(data, data.passive[0])
    on_border = K > 1e-6
    np.testing.assert_allclose(configuration.needed_friction(K[on_border], B[on_border]), 1.0, rtol=1e-9)
    assert configuration.is_passive(0.9 * K[on_border], 0.9 * B[on_border]).all()


def test_passivity_is_left_out_where_it_is_not_derived_and_empty_without_friction() -> None:
    assert drawn(Configuration(mass=1.0, rate=1.0, hold="impulse")).passive == ()
    (nowhere,) = drawn(Configuration(mass=1.0, rate=1.0)).passive
    assert not nowhere.is_seen


def test_the_operating_point_is_seen_with_what_it_feels() -> None:
    data = drawn(DEVICE, 2000.0, 5.0)
    (point,) = data.points
    assert point.is_seen
    assert (point.k, point.b) == DEVICE.equivalent(2000.0, 5.0)
    # Near the origin of a wide region, what is near it is looked at.
    assert data.sheets[0].view.K_to < 0.5 * stable_region(DEVICE)[0]


def test_of_an_unstable_point_the_limit_that_it_is_beyond_is_seen() -> None:
    data = drawn(Configuration(mass=0.2, rate=1000.0), 3000.0, 1.0)
    assert data.boundaries[0].is_seen
    assert np.nanmax(data.boundaries[0].K) > 3000.0


def test_a_point_far_out_does_not_hide_the_rest() -> None:
    data = drawn(DEVICE, 1e300, 5.0)
    assert not data.points[0].is_seen
    assert data.boundaries[0].is_seen


def test_the_view_can_be_given() -> None:
    view = drawn(DEVICE, K_to=500.0, B_to=0.5).sheets[0].view
    assert (view.K_to, view.B_from, view.B_to) == (500.0, 0.0, 0.5)
    assert drawn(DEVICE, total=True).sheets[0].view.B_from == -1.0


def test_a_family_has_a_limit_and_the_same_values_for_each_mass() -> None:
    masses = (0.1, 0.2, 0.4)
    data = drawn(DEVICE, 2000.0, 5.0, masses=masses)
    values = [{(curve.kind, curve.value) for curve in data.iso if curve.mass == mass} for mass in masses]
    assert values[0] == values[1] == values[2] != set()
    for boundary, point, mass in zip(data.boundaries, data.points, masses, strict=True):
        configuration = replace(DEVICE, mass=mass)
        radius = configuration.spectral_radius(boundary.K[finite(boundary)], boundary.B[finite(boundary)])
        np.testing.assert_allclose(radius, 1.0, atol=1e-6)
        assert (point.k, point.b) == configuration.equivalent(2000.0, 5.0)
    assert set(data.columns()["mass_kg"]) == set(masses)


def test_more_masses_than_greys_are_refused() -> None:
    with pytest.raises(UsageError, match="found 6 masses, expected at most 5"):
        drawn(DEVICE, 2000.0, 5.0, masses=(0.1, 0.2, 0.3, 0.4, 0.5, 0.6))


@pytest.mark.thorough(keep=1)
@pytest.mark.parametrize("ending", [".svg", ".png", ".pdf"])
def test_the_same_numbers_draw_the_same_bytes(tmp_path: Path, ending: str) -> None:
    files = [tmp_path / f"{name}{ending}" for name in ("one", "other")]
    for file in files:
        with figure_to(file, 2.0, 1.0) as figure:
            figure.subplots().plot([0.0, 1.0], label="line")
            legend_below(figure, 1)
    assert files[0].read_bytes() == files[1].read_bytes()
    assert b"CreationDate" not in files[0].read_bytes()  # both may be of one second


@pytest.mark.parametrize(("normalised", "total"), [(False, False), (True, False), (True, True)])
def test_the_numbers_are_in_the_units_that_the_axes_name(normalised: bool, total: bool) -> None:
    data = drawn(DEVICE, 2000.0, 5.0, normalised=normalised, total=total)
    columns = {name: np.array(values) for name, values in data.columns().items()}
    here = columns["curve"] == "operating_point"
    K, B, k, b = (columns[name][here][0] for name in data.scale.columns)
    one_K, one_B = (DEVICE.stiffness_unit, DEVICE.damping_unit) if normalised else (1.0, 1.0)
    assert (K * one_K, B * one_B) == pytest.approx((2000.0, 6.0 if total else 5.0))
    assert (k * one_K, b * one_B) == pytest.approx(DEVICE.equivalent(2000.0, 5.0))


@pytest.mark.parametrize(("last", "most"), [(0.95, 12), (8.1, 9), (14.67, 10), (1e-5, 5), (123456.0, 7), (1.0, 10)])
def test_values_are_multiples_of_one_two_or_five(last: float, most: int) -> None:
    values = round_values(last, most)
    step = values[0]
    assert f"{step:e}"[0] in "125"
    assert 1 <= values.size <= most
    assert last - step < values[-1] <= last * (1 + 1e-9)
    np.testing.assert_allclose(np.diff(values), step)
    assert all(round_values(nothing, 5).size == 0 for nothing in (0.0, -1.0, math.nan, math.inf))


def test_numbers_in_a_picture_are_short() -> None:
    said = {0.5: "0.5", 2080.44: "2080", 43452.2: "43452", 110000.0: "110000", 1e6: "1e6", -3.2e-7: "−3.2e−7"}
    assert [short(x) for x in said] == list(said.values())


def test_thinned_lines_keep_their_ends_and_their_gaps() -> None:
    (sheet,) = drawn(DEVICE, 2000.0, 5.0).sheets
    K = np.linspace(0.0, 5000.0, 10001)
    K[4000:5000] = np.nan
    curve = sheet.curve("any", math.nan, K, np.full(K.size, 5.0))
    assert curve.K.size < 600
    assert curve.K[0] == 0.0
    assert curve.K[-1] == 5000.0
    assert np.count_nonzero(np.isnan(curve.K)) == 1
    gap = int(np.flatnonzero(np.isnan(curve.K))[0])
    assert (curve.K[gap - 1], curve.K[gap + 1]) == (K[3999], K[5000])


def test_curves_are_of_values_that_are_round_in_the_units_of_the_file() -> None:
    (sheet,) = drawn(DEVICE).sheets
    units = Units.of(["linear"], complete([Written("N/m", "lbf/in", 1.0 / 175.1268352464764)]))
    k, b = curves.values_felt(sheet, 12, 9, units)
    for values, unit in ((k, "N/m"), (b, "N·s/m")):
        shown = units.scaled(values, unit)
        np.testing.assert_allclose(shown, [float(f"{one:.2g}") for one in shown], rtol=1e-9)


def test_few_values_are_felt_where_little_is_stable(monkeypatch: pytest.MonkeyPatch) -> None:
    (sheet,) = drawn(DEVICE).sheets
    nothing: Callable[..., Any] = lambda _, K, B: np.zeros(np.shape(K), bool)  # noqa: ARG005, E731
    monkeypatch.setattr(Configuration, "is_stable", nothing)
    k, b = curves.values_felt(sheet, 5, 5, LINEAR)
    assert k.size == b.size == 0
