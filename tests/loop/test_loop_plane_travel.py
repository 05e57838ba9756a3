"""The travel of a hand in the plane: a disc, a polygon or a box; outside, the whole force fades by the distance."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from loop_rig import assembled
from plane_field import field_of, plane

from hapsim.errors import GuardError, UsageError
from hapsim.loop.guards.travel import _outside, leads_out
from hapsim.loop.ring import FADED
from hapsim.prediction.force_bounds import fade_stiffness, travel_document, travel_error
from hapsim.running import run
from hapsim.scene import chain

SQUARE = [[-0.02, -0.01], [0.03, -0.01], [0.03, 0.02], [-0.02, 0.02]]
TRIANGLE = [[-0.02, -0.01], [0.03, 0.0], [0.0, 0.02]]


def star(seed: int, corners: int) -> list[list[float]]:
    """A polygon with hollows, about (0, 0)."""
    chance = np.random.default_rng(seed)
    each = (np.arange(corners) * 2.0 * math.pi / corners).tolist()
    return [
        [r * math.cos(a), r * math.sin(a)]
        for a, r in zip(each, chance.uniform(0.01, 0.05, corners).tolist(), strict=True)
    ]


def outside(travel: Any, places: np.ndarray) -> list[float]:
    """Distances by the loop's own geometry."""
    record = assembled(plane({"travel": travel})).record
    found = []
    for place in places:
        record.io.position_counts[:2] = np.rint(place / 1e-6)
        found.append(_outside(record.travel, record.io, 0, 0.0))
    return found


@pytest.mark.thorough(keep=3)
@pytest.mark.parametrize("corners", [3, 5, 12, 64])
@pytest.mark.parametrize("turns", [1, -1])
def test_the_distance_outside_a_polygon_is_that_from_its_nearest_edge(corners: int, turns: int) -> None:
    polygon = star(corners, corners)[::turns]
    places = np.random.default_rng(1).uniform(-0.08, 0.08, (300, 2)).round(6)
    boundary = chain.polygon([(x, y) for x, y in polygon])
    expected = [boundary.nearest(*place).distance for place in places]
    np.testing.assert_allclose(outside({"polygon": polygon}, places), expected, rtol=0, atol=1e-12)
    assert 0 < np.count_nonzero(np.array(expected) < 0.0) < 300


def test_the_distance_outside_a_disc_and_a_box() -> None:
    places = np.random.default_rng(2).uniform(-0.1, 0.1, (300, 2)).round(6)
    expected = np.hypot(places[:, 0] - 0.01, places[:, 1] + 0.02) - 0.05
    found = outside({"disc": 0.05, "center": [0.01, -0.02]}, places)
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-15)
    x, y = np.maximum(-0.03 - places[:, 0], places[:, 0] - 0.04), np.abs(places[:, 1]) - 0.05
    expected = np.where(np.maximum(x, y) > 0.0, np.hypot(np.maximum(x, 0.0), np.maximum(y, 0.0)), np.maximum(x, y))
    np.testing.assert_allclose(outside([[-0.03, 0.04], [-0.05, 0.05]], places), expected, rtol=0, atol=1e-15)


TRAVELS = {
    "disc": ({"disc": 0.01, "center": [0.001, 0.0]}, chain.disc(0.01), (0.001, 0.0), [0.15, 0.3]),
    "polygon": ({"polygon": TRIANGLE}, chain.polygon([(x, y) for x, y in TRIANGLE]), (0.0, 0.0), [0.15, 0.3]),
    "box": ([[-0.02, 0.03], [-0.01, 0.02]], chain.polygon([(x, y) for x, y in SQUARE]), (0.0, 0.0), [0.15, 0.4]),
}


@pytest.mark.parametrize("kind", TRAVELS)
def test_outside_the_whole_force_fades_by_the_distance_and_nothing_changes_within(kind: str) -> None:
    travel, boundary, (x, y), velocity = TRAVELS[kind]
    device = {"travel": travel, "travel_margin": 0.02, "force_limit": 1.0}
    with field_of(x=-0.4, y=0.2, stiffness=50.0):
        trace = run(plane(device, {"initial": {"velocity": velocity}}), duration=0.3)
    distance = np.array([boundary.nearest(px - x, py - y).distance for px, py in trace.position])
    left = np.clip(1.0 - distance / 0.02, 0.0, 1.0)
    assert left.min() < 0.9
    assert np.count_nonzero(left == 1.0) > 10
    wanted = np.rint(np.rint(trace.asked_force / trace.force_scale) * left[:, None])
    assert np.abs(wanted - trace.force_counts)[np.hypot(*trace.asked_force.T) < 1.0].max() <= 1.0
    np.testing.assert_array_equal(trace.flags & FADED > 0, distance > 0.0)
    assert trace.report.faded_ticks == np.count_nonzero(distance > 0.0)


@pytest.mark.parametrize("angle", [0.0, 0.7, 2.5, 4.0])
def test_beyond_the_band_the_run_ends_with_what_was_left_and_by_how_much(angle: float) -> None:
    flung = {"initial": {"velocity": [0.5 * math.cos(angle), 0.5 * math.sin(angle)]}}
    where = (
        r"at \(-?0\.0\d+, -?[\de.-]+\) m, 0\.011\d* m outside, where device\.travel goes up to 0\.02 m from \(0, 0\) m"
    )
    with pytest.raises(GuardError, match=rf"channels 0 and 1 are out of their travel at tick \d+: {where}") as caught:
        run(plane({"travel": {"disc": 0.02}, "travel_margin": 0.011}, flung), duration=1.0)
    distance = np.hypot(*caught.value.trace.position.T) - 0.02
    assert np.all(distance[:-1] <= 0.011 + 1e-6)
    assert 0.011 < distance[-1] < 0.0116
    assert not caught.value.trace.force_counts[-1].any()


def test_the_sentences_name_a_polygon_and_a_box() -> None:
    flung = {"initial": {"velocity": [0.0, -0.5]}}
    with pytest.raises(
        GuardError, match=r"device\.travel goes to the edge of a polygon of 3 corners and the force fades"
    ):
        run(plane({"travel": {"polygon": TRIANGLE}, "travel_margin": 0.004}, flung), duration=1.0)
    with pytest.raises(GuardError, match=r"goes from -0\.02 to 0\.03 m and from -0\.01 to 0\.02 m and the force fades"):
        run(plane({"travel": [[-0.02, 0.03], [-0.01, 0.02]], "travel_margin": 0.004}, flung), duration=1.0)


def test_a_hand_that_is_armed_outside_may_stay_there_and_not_go_farther() -> None:
    device = {"travel": {"disc": 0.02}, "travel_margin": 0.01}
    resting = {"initial": {"position": [0.04, 0.03]}}
    assert run(plane(device, resting), duration=0.05).report.ending == "done"
    leaving = {"initial": {"position": [0.04, 0.03], "velocity": [0.4, 0.3]}}
    with pytest.raises(GuardError, match=r"0\.04\d* m outside"):
        run(plane(device, leaving), duration=1.0)


def test_a_margin_is_a_tenth_of_the_smaller_width_and_wide_enough_for_the_force() -> None:
    assert plane({"travel": {"disc": 0.08}}).travel_margins == pytest.approx((0.016, 0.016))
    assert plane({"travel": {"polygon": TRIANGLE}}).travel_margins == pytest.approx((0.003, 0.003))
    assert plane({"travel": [[-0.02, 0.03], [-0.01, 0.02]]}).travel_margins == pytest.approx((0.003, 0.003))
    scene = plane({"travel": {"disc": 0.08}, "travel_margin": 0.002})
    least = 10.0 / fade_stiffness(scene, 0)
    with pytest.raises(UsageError, match=r"of up to 10 N fades over 0\.002 m"):
        run(scene, duration=0.1)
    assert not travel_error(plane({"travel": {"disc": 0.08}, "travel_margin": least * 1.001}))
    assert travel_error(plane({"travel": {"disc": 0.08}, "travel_margin": least * 0.999}))
    document = travel_document(plane({"travel": {"disc": 0.08, "center": [0.01, 0.0]}}))
    assert document["limits_m"] == ((pytest.approx(-0.07), pytest.approx(0.09)), (-0.08, 0.08))
    assert document["area_m"] == {"disc": 0.08, "center": (0.01, 0.0)}


@pytest.mark.parametrize(
    ("travel", "angle", "presses"),
    [
        ({"disc": 0.02}, 0.0, (1.0, 0.0)),
        ({"disc": 0.02}, math.pi / 4.0, (1.0, 1.0)),
        ({"disc": 0.02}, math.pi, (-1.0, 0.0)),
        ([[-0.02, 0.02], [-0.03, 0.03]], 0.0, (1.0, 0.0)),
        ({"disc": 0.04}, 0.0, (0.0, 0.0)),
    ],
)
def test_a_handle_at_a_round_stop_is_no_dead_sensor(travel: Any, angle: float, presses: tuple[float, float]) -> None:
    """Within the margin of an edge and pressed to it by this channel, a position that stands still proves nothing."""
    record = assembled(plane({"travel": travel})).record
    record.io.position_counts[:2] = np.rint([0.0195e6 * math.cos(angle), 0.0195e6 * math.sin(angle)])
    for c, side in enumerate(presses):
        assert leads_out(record.travel, record.io, c, 3.0) == (side > 0.0)
        assert leads_out(record.travel, record.io, c, -3.0) == (side < 0.0)
