"""Chains of straight pieces and arcs, beside thousands of points along them."""

import math
from functools import cache
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hapsim.scene.chain import (
    Chain,
    TooRoundError,
    capsule,
    crossing,
    disc,
    half_plane,
    polygon,
    smooth_path,
    straight_path,
)

HOOK = [(0.0, 0.0), (0.05, 0.0), (0.05, 0.04), (0.02, 0.02), (0.0, 0.04)]
PATH = [(0.0, 0.0), (0.02, 0.01), (0.05, 0.01), (0.03, -0.03)]
CHAINS = {
    "disc": disc(0.02),
    "capsule": capsule((0.0, 0.0), (0.03, 0.01), 0.002),
    "rounded hook": polygon(HOOK, 0.002),
    "sharp hook": polygon(HOOK),
    "straight path": straight_path(PATH[:3], 0.003),
    "closed straight path": straight_path(PATH, 0.001, closed=True),
    "smooth path": smooth_path(PATH),
    "smooth ring": smooth_path(PATH, closed=True),
    "two places": smooth_path(PATH[:2]),
}
SIDES = {"as built": lambda chain: chain, "reversed": Chain.reversed}
BOTH = [
    (name, side)
    for name in CHAINS
    for side in SIDES
    if side == "as built" or name in {"disc", "capsule", "rounded hook", "sharp hook"}
]
place = st.tuples(st.floats(-0.06, 0.06), st.floats(-0.06, 0.06))


@pytest.mark.parametrize(("name", "side"), BOTH)
def test_pieces_join_without_a_gap(name: str, side: str) -> None:
    pieces = SIDES[side](CHAINS[name]).pieces
    for number, piece in enumerate(pieces):
        if pieces[piece.after].before == number:
            assert math.dist(piece.at(1.0), pieces[piece.after].at(0.0)) < 1e-12


@cache
def places_along(name: str) -> np.ndarray:
    pieces = CHAINS[name].pieces
    return np.array([piece.at(float(share)) for piece in pieces for share in np.linspace(0.0, 1.0, 2000)])


@pytest.mark.parametrize(("name", "side"), BOTH)
@settings(max_examples=30, deadline=None)
@given(at=place)
def test_nearest_place_is_the_nearest_of_all(name: str, side: str, at: tuple[float, float]) -> None:
    chain, along = SIDES[side](CHAINS[name]), places_along(name)
    seen = chain.nearest(*at)
    assert abs(seen.distance) == pytest.approx(np.hypot(*(along - at).T).min(), abs=4e-5)
    foot = np.array(at) - seen.distance * np.array(seen.normal)
    assert np.hypot(*(along - foot).T).min() < 4e-5


@pytest.mark.parametrize("name", CHAINS)
@settings(max_examples=30, deadline=None)
@given(at=place)
def test_normal_and_curvature_are_derivatives(name: str, at: tuple[float, float]) -> None:
    chain, h = CHAINS[name], 1e-7
    seen = chain.nearest(*at)
    (nx, ny), t = seen.normal, (-seen.normal[1], seen.normal[0])
    ahead, behind = (chain.nearest(at[0] + s * h * t[0], at[1] + s * h * t[1]) for s in (1.0, -1.0))
    if (
        abs(seen.distance) < 1e-4
        or abs(seen.curvature) > 1e4
        or ahead.piece != seen.piece
        or behind.piece != seen.piece
    ):
        return
    assert (nx * nx + ny * ny) == pytest.approx(1.0)
    outward = chain.nearest(at[0] + h * nx, at[1] + h * ny)
    if outward.piece == seen.piece:
        assert outward.distance - seen.distance == pytest.approx(h, rel=1e-3)
    turned = [(a - b) / (2.0 * h) for a, b in zip(ahead.normal, behind.normal, strict=True)]
    assert turned[0] * t[0] + turned[1] * t[1] == pytest.approx(seen.curvature, rel=1e-3, abs=1e-3)


def test_free_side_of_closed_forms_is_outside_unless_reversed() -> None:
    for chain in (disc(0.01), polygon([(-1.0, -1.0), (-1.0, 1.0), (1.0, 1.0), (1.0, -1.0)])):  # clockwise too
        assert chain.nearest(0.001, 0.0).distance < 0.0 < chain.reversed().nearest(0.001, 0.0).distance
        assert chain.nearest(3.0, 0.2).distance > 0.0 > chain.reversed().nearest(3.0, 0.2).distance


def test_half_plane_is_free_where_it_points_however_far() -> None:
    wall = half_plane((0.0, 2.0))
    assert wall.nearest(1e5, 0.25).distance == pytest.approx(0.25)
    assert wall.nearest(-1e5, -0.25).distance == pytest.approx(-0.25)
    assert wall.reversed().nearest(7.0, 0.25).distance == pytest.approx(-0.25)


def test_corners_that_do_not_fit_name_the_largest_radius_that_does() -> None:
    box = [(0.0, 0.0), (0.05, 0.0), (0.05, 0.04), (0.0, 0.04)]
    with pytest.raises(TooRoundError) as error:
        polygon(box, 0.03)
    assert error.value.most == pytest.approx(0.02)
    polygon(box, 0.02)


def test_smooth_path_has_no_corner_and_passes_through_its_places() -> None:
    for closed in (False, True):
        path = smooth_path(PATH, closed=closed)
        assert all(abs(path.nearest(*at).distance) < 1e-12 for at in PATH)
        outline = np.array(smooth_path(PATH, closed=closed).outline(0.001)[: 4000 if closed else None])
        if closed:
            steps = np.diff(outline, axis=0)
            steps = steps[np.hypot(*steps.T) > 1e-12]
            turns = [abs(math.atan2(a[0] * b[1] - a[1] * b[0], float(a @ b))) for a, b in pairwise(steps)]
            assert max(turns) < 0.002


def test_sides_that_cross_are_found() -> None:
    assert crossing([(0.0, 0.0), (1.0, 1.0), (1.0, 0.0), (0.0, 1.0)], closed=True) == (0, 2)
    assert crossing([(0.0, 0.0), (1.0, 1.0), (1.0, 0.0), (0.0, 1.0)], closed=False) == (0, 2)
    assert crossing(HOOK, closed=True) is None
    assert crossing(PATH, closed=False) is None
