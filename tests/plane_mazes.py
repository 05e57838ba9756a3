"""Random mazes of walls on a grid, and a place that follows a hand over them: a referee of outlines and of surfaces.
`pressed`, `thrown` and `worked` set a maze that hapsim runs against it.

A wall is known here by convex bodies: all places within `radius` of the hull of some corners. No surface is followed:
wherever the place is, each body leaves free what is beyond the line that supports it there, and inside the cell of
these lines the place goes to where the hand is nearest, until it goes no further. So it never passes through a body.
"""

from __future__ import annotations

import math
import random
from collections.abc import Iterator, Mapping, Sequence
from itertools import pairwise
from typing import Any, NamedTuple

import numba
import numpy as np
from numpy.typing import NDArray

import hapsim
from hapsim.cordis.program import compile_scene
from hapsim.scene import Scene
from tests.cordis.plane_scenes import moved, scene_of

Floats = NDArray[np.float64]
Point = tuple[float, float]

GRID = 0.01  # m
OFF_M, SWING_M, LOOP_J, OUT_M = 1e-7, 1e-6, 1e-9, 1e-5
"""Bounds: of a force over K, of a hand at rest from peak to peak, of the work on a closed way, and of a place of a hand
that may still move by the delay of its force."""
SEAM = 2e-13  # m: bodies are thicker by this, so that no rounding parts those that meet
_FAR = 10.0  # m: half of the edge of a half plane
_OUTSIDE = 0.1  # m: a hand so far from the middle has left the maze
_ROUNDS = 500


class Wall(NamedTuple):
    """A form as a scene has it, and the bodies that make it up: corners (counterclockwise), and radius in m."""

    form: Mapping[str, Any]
    bodies: Sequence[tuple[Sequence[Point], float]]
    side: str = "outside"
    rounding: float = 0.0

    @property
    def module(self) -> dict[str, Any]:
        return {"type": "shape", "form": dict(self.form), "side": self.side, "round": self.rounding}


class Maze(NamedTuple):
    """The bodies of walls as numbers: body i has corners from begin[i] to before begin[i + 1]. `wall`: its number."""

    begin: NDArray[np.int64]
    corners: Floats
    radius: Floats
    inside: NDArray[np.bool_]
    wall: NDArray[np.int64]


def maze_of(walls: Sequence[Wall]) -> Maze:
    bodies = [(body, i, wall.side == "inside") for i, wall in enumerate(walls) for body in wall.bodies]
    begin = np.cumsum([0, *(len(corners) for (corners, _), _, _ in bodies)])
    corners = np.array([corner for (corners, _), _, _ in bodies for corner in corners], float)
    radius, number, inside = (
        np.array(each) for each in zip(*((r, i, is_in) for (_, r), i, is_in in bodies), strict=True)
    )
    return Maze(begin.astype(np.int64), corners, radius.astype(float), inside, number.astype(np.int64))


@numba.njit(cache=True)
def _distance(maze, i, x, y, wx=0.0, wy=0.0):
    """Returns the distance, m, of (x, y) from the material of body i, negative within, and its normal into the free. At
    a corner it is that of the side which is least in the way of (wx, wy)."""
    first, last = maze.begin[i], maze.begin[i + 1]
    most, mx, my, least, cx, cy = -np.inf, 0.0, 1.0, np.inf, 0.0, 0.0
    for k in range(first, last):
        ax, ay = maze.corners[k]
        bx, by = maze.corners[k + 1 if k + 1 < last else first]
        dx, dy = bx - ax, by - ay
        size = math.hypot(dx, dy)
        t = 0.0
        if size > 0.0:
            t = min(max(((x - ax) * dx + (y - ay) * dy) / (size * size), 0.0), 1.0)
            s = ((x - ax) * dy - (y - ay) * dx) / size
            beside = abs(s - most) < 1e-13 and dy * wx - dx * wy > (mx * wx + my * wy) * size
            if s > most + 1e-13 or beside:
                most, mx, my = s, dy / size, -dx / size
        px, py = ax + t * dx, ay + t * dy
        away = math.hypot(x - px, y - py)
        if away < least:
            least, cx, cy = away, px, py
    if last - first > 2 and most <= 1e-12:
        distance, nx, ny = most, mx, my
    elif least < 1e-12:
        distance, nx, ny = (most if last - first > 2 else least), mx, my
    else:
        distance, nx, ny = least, (x - cx) / least, (y - cy) / least
        if last - first > 2 and least < 1e-6 and least <= most * (1.0 + 1e-9):
            nx, ny = mx, my
    if maze.inside[i]:
        distance, nx, ny = maze.radius[i] - distance, -nx, -ny
    else:
        distance -= maze.radius[i]
    return distance - SEAM, nx, ny


@numba.njit(cache=True)
def depths(maze, x, y):
    """Returns how deep each place is within that body in which it is deepest, m, negative where it is free."""
    found = np.full(x.size, -np.inf)
    for n in range(x.size):
        for i in range(maze.radius.size):
            found[n] = max(found[n], -_distance(maze, i, x[n], y[n])[0])
    return found


@numba.njit(cache=True)
def _nearest_in(lines, count, hx, hy):
    """Returns the place nearest to the hand on the free side of all lines n.q >= b, and the two it is held by (-1)."""
    qx, qy, held, also = hx, hy, -1, -1
    for i in range(count):
        nx, ny, b = lines[i]
        if nx * qx + ny * qy >= b:
            continue
        off = b - nx * hx - ny * hy
        bx, by, low, high, below, above = hx + off * nx, hy + off * ny, -np.inf, np.inf, -1, -1
        for j in range(i):
            slope = -lines[j, 0] * ny + lines[j, 1] * nx
            need = lines[j, 2] - lines[j, 0] * bx - lines[j, 1] * by
            if slope > 1e-13 and need / slope > low:
                low, below = need / slope, j
            elif slope < -1e-13 and need / slope < high:
                high, above = need / slope, j
        t, held, also = 0.0, i, -1
        if low > 0.0:
            t, also = low, below
        if high < t:
            t, also = high, above
        qx, qy = bx - t * ny, by + t * nx
    return qx, qy, held, also


@numba.njit(cache=True)
def _step(maze, lines, px, py, hx, hy):
    """Returns where the place at (px, py) goes for a hand at (hx, hy), and whether two lines hold it there."""
    count = maze.radius.size
    for i in range(count):
        distance, nx, ny = _distance(maze, i, px, py, hx - px, hy - py)
        lines[i] = nx, ny, nx * px + ny * py - distance
    qx, qy, _, other = _nearest_in(lines, count, hx, hy)
    for used in range(count, lines.shape[0]):  # what is free within a curve is less than what its tangents leave
        least = -1e-13
        for i in range(count):
            if maze.inside[i]:
                distance, nx, ny = _distance(maze, i, qx, qy)
                if distance < least:
                    least = distance
                    lines[used] = nx, ny, nx * qx + ny * qy - distance
        if least == -1e-13:
            break
        qx, qy, _, other = _nearest_in(lines, used + 1, hx, hy)
    return qx, qy, other >= 0


@numba.njit(cache=True)
def _place(maze, lines, px, py, hx, hy):
    """Returns where the place rests, and whether two lines hold it there."""
    two = False
    for _ in range(_ROUNDS):
        qx, qy, two = _step(maze, lines, px, py, hx, hy)
        step = math.hypot(qx - px, qy - py)
        px, py = qx, qy
        if step < 1e-13:
            break
    return px, py, two


@numba.njit(cache=True)
def _follow(maze, path, begin, place):
    lines = np.zeros((maze.radius.size + 100, 3))
    px, py = begin
    for n in range(path.shape[0]):
        px, py, _ = _place(maze, lines, px, py, path[n, 0], path[n, 1])
        place[n] = px, py


def places_of(maze: Maze, path: Floats, begin: Floats | None = None) -> Floats:
    """Returns the place, m, at each row of a hand's path. It begins at `begin`, or where the hand does, in the free."""
    place = np.zeros_like(path)
    _follow(maze, path, path[0] if begin is None else begin, place)
    return place


@numba.njit(cache=True)
def _push(maze, path, velocity, force, K, B, mass, friction, T):
    """Moves a hand from the first row of `path` on, by the force of the sample before, and damped in the surface."""
    lines = np.zeros((maze.radius.size + 100, 3))
    x, y = path[0]
    (vx, vy), (fx, fy), (px, py) = velocity, (0.0, 0.0), (x, y)
    lasts = math.exp(-friction * T / mass)
    for n in range(1, path.shape[0]):
        ux, uy = (force[0] + fx) / friction, (force[1] + fy) / friction
        px, py, two = _place(maze, lines, px, py, x, y)
        dx, dy, gx, gy = px - x, py - y, (x - path[max(n - 2, 0), 0]) / T, (y - path[max(n - 2, 0), 1]) / T
        away, fx, fy = math.hypot(dx, dy), K * dx, K * dy
        if away > 0.0 and not two:
            speed = (gx * dx + gy * dy) / away
            gx, gy = speed * dx / away, speed * dy / away
        if away > 0.0:
            fx, fy = fx - B * gx, fy - B * gy
        x += ux * T + (vx - ux) * (1.0 - lasts) * mass / friction
        y += uy * T + (vy - uy) * (1.0 - lasts) * mass / friction
        vx, vy = ux + (vx - ux) * lasts, uy + (vy - uy) * lasts
        path[n] = x, y


class Pressed(NamedTuple):
    """A hand that a constant push presses for six seconds, in m. `swing` and `own_swing`: peak to peak in the sixth, of
    hapsim's hand and the referee's; `off`: what the force at its end is off by, over K; `leaves`: no wall ends it."""

    swing: float
    own_swing: float
    off: float
    leaves: bool
    scene: Scene
    end: Point


def pressed(seed: int) -> Pressed | None:
    """Presses a hand that is slow against a maze; None where no place is free."""
    chance, rng = random.Random(seed), np.random.default_rng(seed)
    walls = random_walls(chance)
    maze = maze_of(walls)
    if (at := _free(maze, rng)) is None:
        return None
    force, velocity = _vector(rng, 0.1, 0.7), _vector(rng, 0.01, 0.3)
    K, B, mass, friction = (
        rng.uniform(300.0, 1200.0),
        rng.choice([0.0, 2.0]),
        rng.uniform(0.1, 0.3),
        rng.uniform(2.0, 6.0),
    )
    scene = _scene(walls, at, velocity, force, K=K, B=B, mass=mass, friction=friction)
    trace = hapsim.run(scene, duration=6.0)
    path = np.vstack([at, trace.position])
    own = np.tile(at, (6000, 1))
    _push(maze, own, velocity, force, K, B, mass, friction, 1e-3)
    off = trace.force[-1] / K - (places_of(maze, path)[-1] - path[-1])
    swings = (float(np.ptp(one[-1000:], axis=0).max()) for one in (path, own))
    return Pressed(*swings, math.hypot(*off), np.abs(path[-1]).max() > _OUTSIDE, scene, tuple(path[-1].tolist()))


def thrown(seed: int) -> float:
    """Returns how far out of a closed room, m, less than 0 within, the place of a hand at rest is that was thrown into
    its walls by up to 0.9 of their thickness in a sample."""
    chance, rng = random.Random(seed), np.random.default_rng(seed)
    corners, half, turned, radius = (
        chance.choice((3, 4, 5, 8)),
        chance.choice((0.001, 0.002)),
        chance.random(),
        2 * GRID,
    )
    ring = radius * np.exp(2j * math.pi * (np.arange(corners) + turned) / corners)
    beyond = chance.choice((None, None, 0.0, 1e-9, half))  # half: bars without it are as thin as that where they meet

    def build(a: complex, b: complex) -> Wall:
        begin, end = (a.real, a.imag), (b.real, b.imag)
        return capsule(begin, end, half) if beyond is None else _bar(begin, end, half, beyond)

    walls = [build(ring[i - 1], ring[i]) for i in range(corners)]
    for end in 0.3 * radius * np.exp(2j * math.pi * (np.arange(chance.randint(0, 2)) + chance.random())):
        walls.append(build(ring[0], end))
    velocity, force = _vector(rng, 0.3, 900.0 * half * (2 - (beyond in (0.0, 1e-9)))), _vector(rng, 0.1, 2.0)
    scene = _scene(walls, np.array([-0.1, 0.2]) * radius, velocity, force, K=1000.0, B=2.0, mass=0.2, friction=6.0)
    trace = hapsim.run(scene, duration=4.0)
    place = complex(*(trace.position[-1] + trace.force[-1] / 1000.0))
    out = [(place * (side.conjugate() / abs(side))).real - abs(side) for side in 0.5 * (ring + np.roll(ring, 1))]
    return float(max(out) + half)


def worked(seed: int) -> list[float]:
    """Returns the work, J, that a hand is given on closed ways within the material of a maze, pressed all the way."""
    chance, rng = random.Random(seed), np.random.default_rng(seed)
    walls, found = random_walls(chance), list[float]()
    maze = maze_of(walls)
    program = compile_scene(scene_of({f"w{i}": wall.module | {"stiffness": 1000.0} for i, wall in enumerate(walls)}))
    for _ in range(3):
        if (at := _free(maze, rng)) is None:
            break
        into = at + np.linspace(0.0, 1.0, 1001)[:, None] * _vector(rng, 0.05, 0.05)
        place, depth, n = at, rng.uniform(2e-4, 1.5e-3), 0
        while n < len(into) and math.dist(place, into[n]) < depth:
            place, n = places_of(maze, into[n : n + 1], place)[0], n + 1
        if n == len(into):
            continue
        into = into[:n]
        corners = [into[-1], *(into[-1] + rng.uniform(-0.003, 0.003, (2, 2))), into[-1]]
        sides = [
            a + np.linspace(0.0, 1.0, int(math.dist(a, b) / 2e-7) + 2)[1:, None] * (b - a) for a, b in pairwise(corners)
        ]
        way = np.vstack([into[-1], *sides])
        force = moved(program, np.vstack([into[:-1], way]))[len(into) - 1 :]
        if np.hypot(*force.T).min() > 1e-6 and math.dist(force[0], force[-1]) < 1e-6:
            found.append(float((0.5 * (force[1:] + force[:-1]) * np.diff(way, axis=0)).sum()))
    return found


def _free(maze: Maze, rng: np.random.Generator) -> Floats | None:
    """Returns a place that is free, 0.2 mm from every wall, if one of 300 is."""
    at = rng.uniform(-0.04, 0.04, (300, 2))
    free = depths(maze, *at.T.copy()) < -2e-4
    return at[free.argmax()] if free.any() else None


def _vector(rng: np.random.Generator, least: float, most: float) -> Floats:
    angle = rng.uniform(0.0, 2.0 * math.pi)
    return rng.uniform(least, most) * np.array([math.cos(angle), math.sin(angle)])


def _scene(
    walls: Sequence[Wall],
    at: Floats,
    velocity: Floats,
    force: Floats,
    *,
    K: float,
    B: float,
    mass: float,
    friction: float,
) -> Scene:
    """A hand at a place, with a velocity, that a constant force pushes."""
    device = {"mass": mass, "friction": friction, "delay": 1, "clock": "lockstep", "force_limit": 20.0}
    initial = {"position": at.tolist(), "velocity": velocity.tolist()}
    modules = {f"w{i}": wall.module | {"stiffness": K, "damping": B} for i, wall in enumerate(walls)}
    return scene_of(modules, device=device, mock={"initial": initial, "hand": {"force": force.tolist()}})


def random_walls(chance: random.Random) -> list[Wall]:
    """2 to 40 walls on a grid, in line or at right angles and some aslant, which overlap by nothing, 1 nm, 1 or 2 mm
    or halfway where they meet; some on the edge of a box or half plane; all turned by one angle."""
    count, walls = chance.choice((2, 2, 3, 4, 6, 8, 12, 20, 40)), list[Wall]()
    angle = chance.choice((0.0, 0.0, 0.5 * math.pi, 0.25 * math.pi, 0.1 + 0.2, 1.234))
    size = chance.choice((2, 3, 4))
    thick = chance.choice((0.002, 0.004))
    if chance.random() < 0.5:
        walls.append(_edge(chance, size, angle))
    while len(walls) < count:
        walls += _group(chance, size, thick, angle)
    return walls


def _edge(chance: random.Random, size: int, angle: float) -> Wall:
    kind = chance.choice(("box", "box", "half plane", "disc"))
    if kind == "half plane":
        return half_plane(_turned((0.0, 1.0), angle))
    if kind == "disc":
        return disc(size * GRID, "inside")
    rounding = chance.choice((0.0, 0.002, 0.01))
    if angle == 0.0:
        return box(2 * size * GRID, 2 * size * GRID, rounding, "inside")
    corners = [(-size, -size), (size, -size), (size, size), (-size, size)]
    return polygon([_turned((x * GRID, y * GRID), angle) for x, y in corners], rounding, "inside")


def _group(chance: random.Random, size: int, thick: float, angle: float) -> Iterator[Wall]:
    """Yields a wall, or a polygon that is split in two, or a ring of capsules."""
    kind, half = chance.choice(("bar",) * 8 + ("capsule",) * 5 + ("split", "ring", "box", "hook", "disc")), 0.5 * thick
    x, y = (chance.randint(-size, size) * GRID for _ in range(2))
    if kind in ("bar", "capsule"):
        dx, dy = chance.choice(((1, 0), (1, 0), (0, 1), (0, 1), (1, 1), (1, -2)))
        length = chance.randint(1, 3) * GRID
        begin, end = _turned((x, y), angle), _turned((x + length * dx, y + length * dy), angle)
        beyond = chance.choice((0.0, 1e-9, 0.001, half, half, -half, -half, 1e-9 - half, 0.002 - half))
        rounding = chance.choice((0.0, 0.0, 0.0, 0.5 * half, half))
        yield capsule(begin, end, half) if kind == "capsule" else _bar(begin, end, half, beyond, rounding)
    elif kind == "split":
        (low, high), w = sorted(chance.uniform(-0.008, 0.008) for _ in "ab"), GRID
        left = [(x - w, y - w), (x + low, y - w), (x + high, y + w), (x - w, y + w)]
        right = [(x + low, y - w), (x + w, y - w), (x + w, y + w), (x + high, y + w)]
        yield from (polygon([_turned(corner, angle) for corner in each]) for each in (left, right))
    elif kind == "ring":
        corners = chance.choice((3, 4, 6))
        ring = [(x + GRID * c.real, y + GRID * c.imag) for c in np.exp(2j * math.pi * np.arange(corners) / corners)]
        ring = [_turned(corner, angle) for corner in ring]
        yield from (capsule(ring[i - 1], ring[i], half) for i in range(corners))
    elif kind == "box" and angle == 0.0:
        yield box(chance.randint(1, 2) * GRID, chance.randint(1, 2) * GRID, chance.choice((0.0, 0.002)))
    elif kind == "hook":
        yield hook((x, y), 2 * GRID, thick, angle)
    elif kind == "disc":
        yield disc(chance.choice((0.005, 0.01)))


def _turned(at: Point, angle: float) -> Point:
    c, s = math.cos(angle), math.sin(angle)
    return (c * at[0] - s * at[1], s * at[0] + c * at[1]) if angle else at


def disc(radius: float, side: str = "outside") -> Wall:
    return Wall({"disc": radius}, [([(0.0, 0.0)], radius)], side)


def half_plane(normal: Point) -> Wall:
    nx, ny = (one / math.hypot(*normal) * _FAR for one in normal)
    return Wall({"half_plane": normal}, [([(-ny, nx), (-ny - nx, nx - ny), (ny - nx, -nx - ny), (ny, -nx)], 0.0)])


def capsule(first: Point, last: Point, radius: float) -> Wall:
    return Wall({"capsule": [first, last], "radius": radius}, [([first, last], radius)])


def box(width: float, height: float, rounding: float = 0.0, side: str = "outside") -> Wall:
    x, y = 0.5 * width, 0.5 * height
    return polygon([(-x, -y), (x, -y), (x, y), (-x, y)], rounding, side)._replace(form={"box": [width, height]})


def polygon(corners: Sequence[Point], rounding: float = 0.0, side: str = "outside") -> Wall:
    """A convex polygon, by its corners counterclockwise."""
    inner = [*corners]
    if rounding:
        inner = []
        around = [corners[-1], *corners, corners[0]]
        for (ax, ay), (bx, by), (cx, cy) in zip(around, corners, around[2:], strict=False):
            edges = (bx - ax, by - ay), (cx - bx, cy - by)
            normals = [(dy / math.hypot(dx, dy), -dx / math.hypot(dx, dy)) for dx, dy in edges]
            inner.append(tuple(np.linalg.solve(normals, [nx * bx + ny * by - rounding for nx, ny in normals]).tolist()))
        if min(math.dist(inner[0], inner[1]), math.dist(inner[1], inner[2])) < 1e-9:  # no more than a line
            inner = [inner[0], inner[2]]
    return Wall({"polygon": [*corners]}, [(inner, rounding)], side, rounding)


def _bar(begin: Point, end: Point, half: float, beyond: float, rounding: float = 0.0) -> Wall:
    """A bar of this half thickness, which goes on beyond both places."""
    (x, y), length = begin, math.dist(begin, end)
    ux, uy = (end[0] - x) / length, (end[1] - y) / length
    around = [(-beyond, -half), (length + beyond, -half), (length + beyond, half), (-beyond, half)]
    return polygon([(x + s * ux - t * uy, y + s * uy + t * ux) for s, t in around], rounding)


def hook(at: Point, length: float, thick: float, angle: float) -> Wall:
    """An L: one polygon, with a hollow corner, but two bodies."""
    (x, y), a, t = at, length, thick
    corners = [(x, y), (x + a, y), (x + a, y + t), (x + t, y + t), (x + t, y + a), (x, y + a)]
    bars = [[(x, y), (x + a, y), (x + a, y + t), (x, y + t)], [(x, y), (x + t, y), (x + t, y + a), (x, y + a)]]
    return Wall(
        {"polygon": [_turned(corner, angle) for corner in corners]},
        [([_turned(corner, angle) for corner in bar], 0.0) for bar in bars],
    )
