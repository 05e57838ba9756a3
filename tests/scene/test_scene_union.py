"""Outlines of unions of shapes, beside a scan of the convex bodies that they are made of."""

from __future__ import annotations

import math
import random
from collections.abc import Sequence

import numpy as np
import pytest

from hapsim.scene import Scene
from hapsim.scene.chain import Chain, capsule, disc, half_plane, polygon
from hapsim.scene.union import NothingFreeError, Outline, union
from tests.cordis.plane_scenes import scene_of
from tests.plane_mazes import Wall, depths, maze_of, random_walls

TINY = 1e-8  # m


def bar(left: float, right: float, low: float = -0.005, high: float = 0.005, rounding: float = 0.0) -> Chain:
    return polygon([(left, low), (right, low), (right, high), (left, high)], rounding)


def turned(chain: Chain, angle: float) -> Chain:
    c, s = math.cos(angle), math.sin(angle)
    return Chain(
        tuple(
            one._replace(
                x=c * one.x - s * one.y, y=s * one.x + c * one.y, ex=c * one.ex - s * one.ey, ey=s * one.ex + c * one.ey
            )
            for one in chain.pieces
        )
    )


def corners_of(outline: Outline) -> tuple[int, int]:
    """Returns how many sharp corners are round, and how many hollow."""
    bends = [piece.bend for piece in outline.chain.pieces if piece.bend and not piece.radius]
    return bends.count(1), bends.count(-1)


def chains_of(walls: Sequence[Wall]) -> list[Chain]:
    scene: Scene = scene_of({f"w{i}": wall.module | {"stiffness": 1.0} for i, wall in enumerate(walls)})
    return [link.chain() for link in scene.plane_links.values()]  # type: ignore[union-attr]


@pytest.mark.thorough(keep=30)
@pytest.mark.parametrize("seed", range(60))
def test_the_outline_of_a_random_maze_is_that_of_a_scan(seed: int) -> None:
    """It is closed and goes on in one direction, no part of it is inside a wall, no surface beside a free place is
    missing, and everywhere distance and side are those of the bodies."""
    walls = random_walls(random.Random(seed))
    maze, chains = maze_of(walls), chains_of(walls)
    try:
        outline = union(chains)
    except NothingFreeError:
        at = np.random.default_rng(seed).uniform(-0.06, 0.06, (2, 3000))
        assert (depths(maze, *at) > -TINY).all()
        return
    pieces, owners = outline.chain.pieces, outline.owners
    for i, piece in enumerate(pieces):
        if piece.after != i:
            assert pieces[piece.after].before == i
            assert math.dist(piece.at(1.0), pieces[piece.after].at(0.0)) < TINY
        if math.isfinite(piece.extent):
            along = np.array([piece.at(share) for share in np.linspace(0.0, 1.0, 9)])
            along = along[np.hypot(*along.T) < 1.0]
            assert np.abs(depths(maze, *along.T.copy())).max(initial=0.0) < TINY
            if not (piece.bend == -1 and piece.radius == 0.0):
                own = [abs(chains[owners[i]].nearest(*at).distance) for at in along]
                assert max(own, default=0.0) < TINY
    for chain in chains:
        for one in chain.pieces:
            at = np.array(one.at(0.37) if math.isfinite(one.extent) else (one.x, one.y))
            before = at + 1e-6 * np.array(chain.nearest(*at).normal)  # in a seam it is within the other wall
            if (depths(maze, *np.array([at, before]).T.copy()) < (TINY, -TINY)).all():
                assert abs(outline.chain.nearest(*at).distance) < TINY
    for x, y in np.random.default_rng(seed).uniform(-0.06, 0.06, (60, 2)):
        deep, seen = depths(maze, np.array([x]), np.array([y]))[0], outline.chain.nearest(x, y).distance
        if abs(deep) > TINY:
            assert seen * deep < 0.0
            assert deep > 0.0 or seen == pytest.approx(-deep, abs=TINY)


@pytest.mark.parametrize("angle", [0.0, 0.1 + 0.2, 1.0])
@pytest.mark.parametrize("overlap", [0.0, 5e-10, 1e-9, 1e-6, 0.002, 0.01])
def test_bars_in_line_are_one_bar(overlap: float, angle: float) -> None:
    outline = union([turned(one, angle) for one in (bar(-0.02, 0.5 * overlap), bar(-0.5 * overlap, 0.02))])
    assert corners_of(outline) == (4, 0)
    assert set(outline.owners) == {0, 1}
    assert sum(piece.extent for piece in outline.chain.pieces if not piece.bend) == pytest.approx(0.1)


@pytest.mark.parametrize("overlap", [-1e-9, 0.0, 1e-9, 1e-6, 0.002])
def test_bars_that_meet_in_a_t_or_a_cross_have_hollow_corners(overlap: float) -> None:
    level, upright = bar(-0.02, 0.02), bar(-0.002, 0.002, 0.005 - overlap, 0.03)
    assert corners_of(union([level, upright])) == (6, 2)
    assert corners_of(union([level, bar(-0.002, 0.002, -0.03, 0.03)])) == (8, 4)
    assert corners_of(union([level, bar(0.02 - 0.004, 0.02, 0.005 - overlap, 0.03)])) == (5, 1)
    assert corners_of(union([half_plane((0.0, 1.0)), bar(0.0, 0.01, -overlap, 0.03)])) == (2, 2)
    assert corners_of(union([bar(-0.04, 0.04, -0.03, 0.03).reversed(), bar(0.0, 0.01, -0.03 - overlap, 0.0)])) == (2, 6)


def test_a_shape_that_meets_no_other_keeps_its_pieces() -> None:
    chains = [bar(-0.02, 0.02).reversed(), disc(0.002), capsule((-0.01, 0.0), (-0.005, 0.001), 0.001)]
    pieces = [piece for chain in chains for piece in chain.pieces]
    outline, begin = union(chains), 0
    for i, chain in enumerate(chains):
        assert union([chain]) == Outline(chain, (0,) * len(chain.pieces))
        begins = [begin + one for one in (0, len(chain.pieces))]
        own = outline.chain.pieces[slice(*begins)]
        assert [one._replace(before=one.before - begin, after=one.after - begin) for one in own] == list(chain.pieces)
        assert set(outline.owners[slice(*begins)]) == {i}
        begin = begins[1]
    assert begin == len(pieces)


def test_one_within_another_is_dropped_and_of_two_that_are_alike_the_first_stays() -> None:
    around, within = bar(-0.02, 0.02), disc(0.003)
    assert union([within, around]) == Outline(around, (1,) * 8)
    for one in (around, within, half_plane((1.0, 2.0)), bar(-0.03, 0.03, rounding=0.002).reversed()):
        assert union([one, one, one]) == Outline(one, (0,) * len(one.pieces))


def test_shapes_that_leave_nothing_free_are_an_error() -> None:
    with pytest.raises(NothingFreeError):
        union([half_plane((0.0, 1.0)), half_plane((0.0, -1.0))])
    with pytest.raises(NothingFreeError):
        union([disc(0.01).reversed(), bar(-0.02, 0.02, -0.02, 0.02)])


def test_a_ring_of_walls_has_two_loops() -> None:
    ring = [(0.01, 0.0), (0.0, 0.01), (-0.01, 0.0), (0.0, -0.01)]
    outline = union([capsule(ring[i - 1], ring[i], 0.001) for i in range(4)])
    loops, left = 0, set(range(len(outline.chain.pieces)))
    while left:
        i, loops = left.pop(), loops + 1
        while (i := outline.chain.pieces[i].after) in left:
            left.remove(i)
    assert (loops, corners_of(outline)) == (2, (0, 4))
    assert outline.chain.nearest(0.0, 0.0).distance == pytest.approx(0.01 / math.sqrt(2.0) - 0.001)


def test_where_surfaces_only_touch_each_side_ends_in_a_hollow_corner() -> None:
    above = Chain(tuple(one._replace(y=one.y + 0.01) for one in disc(0.01).pieces))
    outline = union([half_plane((0.0, 1.0)), above])
    corners = [one for one in outline.chain.pieces if one.bend and not one.radius]
    assert [(one.bend, one.extent) for one in corners] == [(-1, pytest.approx(math.pi))] * 2
    for side in (1.0, -1.0):
        assert outline.chain.nearest(side * 0.003, 1e-4).distance == pytest.approx(1e-4)
    assert [outline.owners[outline.chain.pieces.index(one)] for one in corners] in ([0, 1], [1, 0])


def test_before_a_tip_that_touches_another_the_tip_is_nearest() -> None:
    """A hollow corner is at the same place, as near; it belongs to the narrow gap on the other side."""
    flat, steep = (
        polygon([(0.0, 0.0), (0.02, -0.002), (0.02, -0.01)]),
        polygon([(0.0, 0.0), (0.02, 0.01), (0.02, 0.002)]),
    )
    outline = union([flat, steep])
    for x, y in np.random.default_rng(0).uniform((-0.02, -1.0), (-0.001, 1.0), (100, 2)):
        y *= -x  # noqa: PLW2901
        assert outline.chain.nearest(x, y).distance == pytest.approx(math.hypot(x, y))
