"""Loops in the plane: rows in place of ends, a device whose mass is a matrix, and what is felt in two directions."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.linalg import block_diag, expm

from hapsim.prediction.any_hand import AnyHand
from hapsim.theory import Network, margins_of, solve
from hapsim.theory.interface import Ahead, damper_named
from hapsim.theory.network import continuous_pair, felt_pair, part_of, parts_of, principal, proves_stability
from hapsim.theory.network.felt import _motions, continuous_modes, matrices, static_stiffness
from hapsim.theory.network.impedance import device_matrix, loop_impedance
from hapsim.theory.network.modes import SURELY, poles_of
from hapsim.theory.network.network import kinetic_energy
from hapsim.theory.network.rest_poles import poles_at_rest
from hapsim.theory.network.scene_passivity import HeldScene, passivity_of
from hapsim.theory.rows import stretches_of
from hapsim.theory.sample import is_large, loop
from tests.networks import network_of

T = 1e-3
X, Y = [1.0, 0.0], [0.0, 1.0]
COUPLED = [[0.2, 0.05], [0.05, 0.3]]
OUT, IN = 0.019, 0.021  # distances from the centre: a disc, and a ring, of 20 mm pressed by 1 mm
PRESSED = 2000.0 * 0.001  # N
PUSH = 0.2  # N, along the surface


def plane(
    rows: Any, stiffness: Sequence[float], damping: Sequence[float], pulls: Any = None, **changed: Any
) -> Network:
    """Hand of 0.2 kg with two coordinates and 1 N·s/m, 1 kHz, a delay of one sample, zero-order hold."""
    hand = {"channel_mass": [0.2, 0.2], "channel_friction": [1.0, 1.0], "ends": ()}
    links = {"rows": rows, "pulls": pulls, "stiffness": stiffness, "damping": damping}
    return network_of(**hand | links | changed)


def stuck(kt: float, bt: float, rho: float = math.inf) -> Network:
    """The disc's wall, or an edge's, with stuck friction: a bristle along the surface, which is curved by 1/rho."""
    return plane([X, Y, Y, Y], [2000.0, kt, -PRESSED / rho, -PUSH / rho], [5.0, bt, 0.0, 0.0], [X, Y, Y, X])


def test_a_stiff_bristle_without_damping_buzzes_and_one_that_is_not_projected_stiffens_the_wall() -> None:
    assert felt_pair(stuck(3000.0, 0.0)).b[1, 1] == pytest.approx(-3.41, abs=5e-3)
    assert np.abs(poles_of(stuck(3000.0, 0.0))).max() > SURELY
    bent = [[2000.0, -PUSH / OUT], [0.0, 1000.0 - PRESSED / OUT]]
    np.testing.assert_allclose(matrices(stuck(1000.0, 2.0, OUT))[2], bent)
    plain = plane([X, X, Y], [2000.0, 3000.0, 3000.0], [5.0, 0.0, 0.0])
    np.testing.assert_allclose(matrices(plain)[2], np.diag([5000.0, 3000.0]))


def drawn(seed: int, **changed: Any) -> Network:
    """Random scene of one or two hands with two coordinates each and of masses, with links of several rows, by which
    nothing is free."""
    draw = np.random.default_rng(seed)
    hands, masses = int(draw.integers(1, 3)), int(draw.integers(0, 3))
    size, links = 2 * hands + 2 * masses, int(draw.integers(1, 4))
    rows, pulls, k, b, number = [], [], [], [], []
    for link in range(hands + masses + links):
        first, second = draw.choice(hands + masses, 2, replace=False) if hands + masses > 1 else (0, -1)
        first, second = (link, -1) if link < hands + masses else (first, second)
        turn = draw.uniform(0.0, 2.0 * math.pi)
        n, t = np.array([math.cos(turn), math.sin(turn)]), np.array([-math.sin(turn), math.cos(turn)])
        reads, acts = np.zeros((2, size)), np.zeros((2, size))
        for end, sign in ((first, 1.0), (second, -1.0)):
            if end >= 0:
                reads[:, 2 * end : 2 * end + 2] = acts[:, 2 * end : 2 * end + 2] = sign * np.array([n, t])
        stiffness = draw.uniform(50.0, 400.0)
        rows += [reads[0], reads[1], reads[1]]
        pulls += [acts[0], acts[1], acts[0]]
        k += [stiffness, 0.3 * stiffness, draw.uniform(-0.2, 0.2) * stiffness]
        b += [draw.uniform(0.0, 0.5), draw.uniform(0.0, 0.1), 0.0]
        number += [link] * 3
    whole = [draw.uniform(0.1, 0.4, (2, 2)) for _ in range(hands)]
    scene = {
        "channel_mass": block_diag(*[one @ one.T + 0.1 * np.eye(2) for one in whole]),
        "channel_friction": np.repeat(draw.uniform(0.3, 1.5, hands), 2),
        "channel_stiffness": np.repeat(draw.uniform(0.0, 400.0, hands) * draw.integers(0, 2, hands), 2),
        "delay": float(draw.choice([0.0, 0.37, 1.0, 1.6])),
        "hold": str(draw.choice(["zoh", "impulse"])),
        "sampling": str(draw.choice(["ideal", "average"])),
        "point_mass": np.repeat(draw.uniform(0.05, 0.2, masses), 2),
        "link_of_row": number,
    }
    return plane(rows, k, b, pulls, **(scene | changed))


def stepped(network: Network) -> np.ndarray:
    """Matrix (size, size) of one sample, by positions and forces: the device by the exponential of its own equation."""
    channels, masses = network.channel_mass.size, network.point_mass.size
    points, whole = channels + masses, math.floor(network.delay)
    M, b0 = network.mass_matrix, np.diag(network.channel_friction)
    # The device: positions, velocities, integral of the positions since the sample, force.
    rate = np.zeros((4 * channels, 4 * channels))
    x, v, s, f = (slice(i * channels, (i + 1) * channels) for i in range(4))
    one = np.eye(channels)
    rate[x, v], rate[s, x] = one, one
    rate[v, v], rate[v, f] = -np.linalg.solve(M, b0), np.linalg.inv(M)
    rate[v, x] = -np.linalg.solve(M, np.diag(network.channel_stiffness))
    # The state: x, v, read now and before (all points), forces of the last samples, the newest first.
    ages = whole + 1
    size = 2 * channels + 2 * points + ages * channels
    state = np.eye(size)
    now, before = state[2 * channels : 2 * channels + points], state[2 * channels + points : 2 * channels + 2 * points]
    old = [state[2 * channels + 2 * points + i * channels :][:channels] for i in range(ages)]
    assert network.rows is not None
    assert network.pulls is not None
    stretch, growth = network.rows @ now, network.rows @ (now - before)
    force = -network.pulls.T @ (
        network.stiffness[:, None] * stretch + network.damping[:, None] / T * growth
    )  # of all points
    acting = [force[:channels], *old]
    device = np.vstack([state[: 2 * channels], np.zeros((2 * channels, size))])
    pieces = ((network.delay - whole, acting[whole + 1]), (1.0 - network.delay + whole, acting[whole]))
    for n, (share, held) in enumerate(pieces):
        device[f] = held if network.hold == "zoh" else 0.0
        if network.hold == "impulse" and n == 1:
            device[v] += np.linalg.solve(M, held * T)
        device = expm(rate * share * T) @ device
    read = device[x] if network.sampling == "ideal" else device[s] / T
    moved = 2.0 * now[channels:] - before[channels:] + T**2 / network.point_mass[:, None] * force[channels:]
    return np.vstack([device[x], device[v], read, moved, now, *acting[:ages]])


def apart(some: np.ndarray, others: np.ndarray, least: float = 0.05) -> float:
    """Largest distance of a pole of modulus above `least` from the nearest one of the others."""
    return max((float(np.abs(others - one).min()) for one in some if abs(one) > least), default=0.0)


@pytest.mark.parametrize("seed", range(60))
def test_the_poles_are_those_of_a_loop_written_out(seed: int) -> None:
    network = drawn(seed)
    unlike = 1.0 + 0.7 * np.arange(network.channel_mass.size)
    changed = {name: unlike * getattr(network, name) for name in ("channel_friction", "channel_stiffness")}
    network = replace(network, **changed)
    own, poles = np.linalg.eigvals(stepped(network)), poles_of(network)
    assert apart(poles, own) < 1e-9
    assert apart(own, poles) < 1e-9


def turned(network: Network, angle: float) -> Network:
    """The same scene in a frame that is turned; its devices' friction is the same in both directions."""
    turn = np.array([[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]])
    points = (network.channel_mass.size + network.point_mass.size) // 2
    whole, hands = block_diag(*[turn] * points), block_diag(*[turn] * (network.channel_mass.size // 2))
    assert network.rows is not None
    assert network.pulls is not None
    mass = hands @ network.mass_matrix @ hands.T
    return replace(
        network,
        channel_mass=0.5 * (mass + mass.T),
        mass_coupling=None,
        rows=network.rows @ whole.T,
        pulls=network.pulls @ whole.T,
    )


@pytest.mark.parametrize("damper", ["backward", "sensed"])
@pytest.mark.parametrize("sampling", ["ideal", "average"])
def test_a_turned_device_is_one_whose_mass_is_a_matrix(damper: str, sampling: str) -> None:
    rows = np.array([[1.0, 0.0, -1.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.6, 0.8, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]])
    plain = plane(
        rows,
        [300.0, 500.0, 200.0, 80.0],
        [0.4, 1.0, 0.5, 0.1],
        channel_mass=[0.2, 0.35],
        point_mass=[0.02, 0.02],
        sampling=sampling,
        channel_stiffness=[90.0, 90.0],
        damper=[damper_named(damper, None, 1.0 / T)] * 3 + [damper_named("backward", None, 1.0 / T)],
    )
    angle = 0.7
    coupled = turned(plain, angle)
    turn = np.array([[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]])
    assert plain.mass_coupling is None
    assert coupled.mass_coupling is not None
    assert apart(poles_of(plain), poles_of(coupled)) < 1e-12
    for of in (felt_pair, continuous_pair):
        before, after = of(plain, most=math.inf), of(coupled, most=math.inf)
        assert before.reason == after.reason == ""
        np.testing.assert_allclose(after.k, turn @ before.k @ turn.T, atol=1e-7)
        np.testing.assert_allclose(after.b, turn @ before.b @ turn.T, atol=1e-9)
        assert after.share == pytest.approx(before.share, abs=1e-9)
    np.testing.assert_allclose(static_stiffness(coupled), turn @ static_stiffness(plain) @ turn.T, atol=1e-9)
    hertz = [1.0, 20.0, 333.0]
    for before, after in zip(loop_impedance(plain, hertz), loop_impedance(coupled, hertz), strict=True):
        np.testing.assert_allclose(after, turn @ before @ turn.T, rtol=1e-9, atol=1e-9)
    w = np.exp(1j * np.array([0.1, 2.0])) - 1.0
    np.testing.assert_allclose(device_matrix(coupled)(w), turn @ device_matrix(plain)(w) @ turn.T, rtol=1e-9)
    if damper == "backward" and sampling == "ideal":
        held, theta = HeldScene(coupled), np.array([0.1, 1.0])
        assert passivity_of(held).friction == pytest.approx(passivity_of(HeldScene(plain)).friction, rel=1e-6)
        s = 1j * theta[:, None, None] / T
        device = s * plain.mass_matrix + np.eye(2) + 90.0 / s * np.eye(2)
        w = np.exp(1j * theta) - 1.0
        through = np.exp(-1j * theta) * (1.0 - np.exp(-1j * theta)) / (1j * theta)
        whole = device + HeldScene(plain).forces(w) * (through * T / (1j * theta))[:, None, None]
        along = (turn @ np.linalg.inv(whole) @ turn.T)[:, 1, 1]
        np.testing.assert_allclose(held.driving_impedance(theta, 1), 1.0 / along, rtol=1e-9)
    energy = solve(coupled).modes[0].participation, solve(plain).modes[0].participation
    assert energy[0][:2].sum() == pytest.approx(energy[1][:2].sum(), abs=1e-9)
    assert energy[0].sum() == pytest.approx(1.0)
    shares = continuous_modes(coupled)[0].participation, continuous_modes(plain)[0].participation
    assert shares[0][:2].sum() == pytest.approx(shares[1][:2].sum(), abs=1e-9)


@pytest.mark.parametrize(
    "changed",
    [
        {},
        {"scheme": "midpoint"},
        {"scheme": "exact", "substeps": 4},
        {"scheme": "rk4"},
        {"sampling": "average", "damping": [1.0, 0.5, 0.3, 0.2]},
    ],
)
def test_rows_that_are_the_stretches_of_links_change_nothing(changed: dict[str, Any]) -> None:
    ends, links = [[0, 2], [1, -1], [2, 3], [3, -1]], {"stiffness": [400.0, 900.0, 300.0, 100.0]}
    known = {"damping": [0.3, 1.0, 0.0, 0.1], "point_mass": [0.05, 0.1], "margin_links": 3} | links | changed
    by_ends = plane(None, **(known | {"ends": ends}))  # type: ignore[arg-type]
    by_rows = plane(stretches_of(by_ends, False), **known)  # type: ignore[arg-type]
    for one, other in zip(loop(by_ends, inputs=True)[:4], loop(by_rows, inputs=True)[:4], strict=True):
        np.testing.assert_array_equal(one, other)
    assert margins_of(by_rows) == margins_of(by_ends)
    assert poles_at_rest(by_rows) == poles_at_rest(by_ends) == 0
    np.testing.assert_array_equal(parts_of(by_rows), parts_of(by_ends))
    some = np.array([0, 2, 3])
    for one, other in zip(loop(part_of(by_ends, some))[:2], loop(part_of(by_rows, some))[:2], strict=True):
        np.testing.assert_array_equal(one, other)
    hertz = [3.0, 200.0]
    for one, other in zip(loop_impedance(by_ends, hertz), loop_impedance(by_rows, hertz), strict=True):
        np.testing.assert_array_equal(one, other)


def by_hand(network: Network, link: int, name: str, up: bool = True) -> float:
    """Factor on one quantity of a link at which the loop written out stops, or begins, to be stable."""

    def is_stable(factor: float) -> bool:
        value = np.where(network.link_of_row == link, factor, 1.0) * getattr(network, name)
        radius = np.abs(np.linalg.eigvals(stepped(replace(network, **{name: value})))).max()
        return bool(radius <= 1.0 + 1e-9)

    low, high = (1.0, 1.0) if up else (0.0, 1.0)
    while up and is_stable(high):
        low, high = high, 1.1 * high
    for _ in range(60):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if is_stable(middle) else (low, middle)
    return low


@pytest.mark.thorough(keep=1)
@pytest.mark.parametrize("seed", [0, 3])
def test_margins_scale_all_rows_of_a_link_together(seed: int) -> None:
    network = drawn(seed, hold="zoh", delay=1.0)
    assert np.abs(poles_of(network)).max() < 1.0
    found = margins_of(network)
    assert "steps of 10 %" in found.method
    assert len(found.links) == len(set(network.link_of_row.tolist()))
    for link, margin in enumerate(found.links[:2]):
        for name, factor in zip(("stiffness", "damping"), margin, strict=True):
            assert factor == pytest.approx(by_hand(network, link, name), rel=1e-6)


def test_links_of_one_row_have_their_margins_from_the_crossings() -> None:
    c, s = math.cos(0.4), math.sin(0.4)
    pulls = [[c - 0.3 * s, s + 0.3 * c], [-s, c]]
    network = plane([[c, s], [-s, c]], [2000.0, 500.0], [5.0, 1.0], pulls, channel_mass=COUPLED, link_of_row=[2, 0])
    found = margins_of(replace(network, margin_links=4))
    assert (found.method, len(found.links)) == ("", 4)
    assert found.links[1] == found.links[3] == (math.inf, math.inf)
    for link in (0, 2):
        for name, factor in zip(("stiffness", "damping"), found.links[link], strict=True):
            assert factor == pytest.approx(by_hand(network, link, name), rel=1e-6)


def test_a_disc_that_throws_the_hand_off_is_stable_with_none_of_its_stiffness() -> None:
    network = plane([X, Y], [2000.0, -PRESSED / OUT], [5.0, 0.0], link_of_row=[0, 0])
    found = margins_of(network)
    assert found.links[0].stiffness_factor < 1e-7  # where the growth is that of rounding
    held = replace(network, rows=[X, Y, Y], pulls=None, stiffness=[2000.0, -PRESSED / OUT, 100.0],
                   damping=[5.0, 0.0, 1.0], damper=(), link_of_row=[0, 0, 1])  # fmt: skip
    below = margins_of(held).links[0].stiffness_factor
    assert below == pytest.approx(by_hand(held, 0, "stiffness", up=False), rel=1e-6)
    assert 0.9 < below < 1.0
    above = margins_of(held).stabilizing[1].stiffness
    assert above is not None
    assert above[0][0] == pytest.approx(PRESSED / OUT / 100.0, rel=1e-6)


def test_motions_that_nothing_holds_are_counted_and_judged_at_rest() -> None:
    c, s = math.cos(0.3), math.sin(0.3)
    edge = plane([[c, s]], [2000.0], [5.0])
    assert poles_at_rest(edge) == 1
    assert poles_at_rest(replace(edge, channel_friction=[0.0, 0.0])) == 2
    assert poles_at_rest(plane([[c, s]], [0.0], [5.0], channel_friction=[0.0, 0.0])) == 3
    # A mass on a rope that is neither stretched nor slack swings freely across it.
    rope = plane([[c, s, -c, -s], [1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0]], [1500.0, 300.0, 500.0],
                 [2.0, 2.0, 1.0], point_mass=[0.05, 0.05])  # fmt: skip
    assert poles_at_rest(rope) == 2
    assert solve(rope).spectral_radius == 1.0
    # A triangle of masses turns and drifts: three motions, each a double pole, whatever its directions round to.
    corners = np.array([[0.0, 0.0], [0.031, 0.012], [0.007, 0.044]])
    rows = np.zeros((3, 8))
    for row, (a, b) in zip(rows, ((0, 1), (1, 2), (2, 0)), strict=True):
        n = (corners[a] - corners[b]) / np.linalg.norm(corners[a] - corners[b])
        row[2 + 2 * a : 4 + 2 * a], row[2 + 2 * b : 4 + 2 * b] = n, -n
    free = plane(rows, [900.0, 800.0, 700.0], [0.1, 0.2, 0.3], point_mass=[0.1] * 6)
    assert poles_at_rest(free) == 6 + 2
    assert solve(free).spectral_radius == 1.0
    # Friction that slides reads the pressure and pulls along: it brakes nothing, and the hand drifts on.
    slides = plane([X, X], [2000.0, 600.0], [5.0, 1.5], [X, Y], channel_friction=[0.0, 0.0])
    assert poles_at_rest(slides) == 2
    assert not felt_pair(slides).reason
    np.testing.assert_allclose(felt_pair(slides).k[:, 1], 0.0, atol=1e-9)
    assert felt_pair(slides).k[1, 0] == pytest.approx(600.0, rel=0.05)
    # A brake along y that pulls as the spring across does: the spring balances it, and the hand drifts on, aside.
    aside = plane([X, Y], [2000.0, 0.0], [5.0, 3.0], 2 * [[1.0, 0.3]], channel_friction=[0.0, 0.0])
    assert poles_at_rest(aside) == 2
    found = felt_pair(aside)
    assert found.b[:, 1] == pytest.approx(found.k[:, 0] * 3.0 / 2000.0, rel=1e-9)


def test_an_impulse_along_one_coordinate_moves_both_where_the_mass_is_a_matrix() -> None:
    network = plane([X, Y], [2000.0, 800.0], [5.0, 2.0], channel_mass=COUPLED)
    w, states = np.linalg.eig(loop(network).change)
    moving, energy = (states[:2], states[2:4]), kinetic_energy(network, states[:2])
    carried = _motions(network, np.log1p(w), states, moving, energy, np.eye(len(states))[:, 2:4]).carried
    np.testing.assert_allclose(carried.sum(axis=2), np.linalg.inv(COUPLED), atol=1e-6)


def test_points_that_rows_or_masses_join_are_one_part() -> None:
    network = plane(np.eye(6)[[0, 1, 4]] - np.eye(6)[[4, 1, 4]], [10.0] * 3, [0.0] * 3, channel_mass=[0.2] * 4,
                    channel_friction=[1.0] * 4, point_mass=[0.1, 0.1])  # fmt: skip
    part = parts_of(network)
    assert len({*part.tolist()}) == 5
    assert part[0] == part[4]
    reads = replace(network, rows=np.eye(6)[[0, 1, 4]], pulls=np.eye(6)[[5, 1, 4]])
    assert parts_of(reads)[0] == parts_of(reads)[5]
    assert parts_of(network, np.array([1, 2])).tolist() == [0, 1, 2, 3, 4, 5]
    joined = parts_of(network, also=[(0, 1), (2, 3)])
    assert [[int(i) for i in np.flatnonzero(joined == one)] for one in dict.fromkeys(joined)] == [
        [0, 1, 4],
        [2, 3],
        [5],
    ]
    mass = np.diag([0.2] * 4)
    mass[1, 2] = mass[2, 1] = 0.05
    coupled = replace(network, channel_mass=mass)
    assert parts_of(coupled)[1] == parts_of(coupled)[2]
    inside = part_of(coupled, np.array([1, 2]))
    np.testing.assert_array_equal(inside.mass_matrix, mass[1:3, 1:3])
    assert part_of(coupled, np.array([0, 4])).mass_coupling is None


def test_the_principal_directions_are_at_right_angles_the_stiffest_first() -> None:
    draw = np.random.default_rng(4)
    for _ in range(200):
        angle, k, b = draw.uniform(0.0, math.pi), np.sort(draw.uniform(-500.0, 3000.0, 2))[::-1], draw.uniform(0, 9, 2)
        turn = np.array([[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]])
        aside = draw.uniform(-50.0, 50.0) * np.array([[0.0, 1.0], [-1.0, 0.0]])  # turns, and drives along nothing
        first, second = principal(turn * k @ turn.T + aside, turn * b @ turn.T)
        np.testing.assert_allclose(first, [angle, k[0], b[0]], atol=1e-9)
        np.testing.assert_allclose(second, [(angle + math.pi / 2) % math.pi, k[1], b[1]], atol=1e-9)
    assert principal(np.diag([1.0, 5.0]), np.diag([2.0, 3.0])) == ((math.pi / 2, 5.0, 3.0), (0.0, 1.0, 2.0))


def test_a_round_pair_has_the_directions_of_its_damping_and_else_x_and_y() -> None:
    first, second = principal(np.diag([700.0, 700.0]), np.diag([1.0, 4.0]))
    assert (first, second) == ((math.pi / 2, 700.0, 4.0), (0.0, 700.0, 1.0))
    first, second = principal(np.diag([700.0, 700.0 + 1e-8]), np.diag([2.0, 2.0]))
    assert (first.angle, second.angle) == (0.0, math.pi / 2)
    assert principal(np.zeros((2, 2)), np.zeros((2, 2)))[0] == (0.0, 0.0, 0.0)
    assert all(0.0 <= one.angle < math.pi for one in principal(np.array([[5.0, -1e-17], [-1e-17, 1.0]]), np.eye(2)))


def test_the_hand_that_shakes_a_device_whose_mass_is_a_matrix_is_found() -> None:
    network = plane([X, Y], [2000.0, 800.0], [5.0, 2.0], channel_mass=COUPLED)
    any_hand = AnyHand(("hand.x", "hand.y"), (0, 1), network, ("hand.x", "hand.y"))
    shaken = any_hand.shaking
    assert shaken is not None
    assert shaken.stiffness > 1e5
    own, mass = np.zeros(2), np.array(COUPLED)
    at = any_hand.names.index(shaken.name)
    own[at] += shaken.stiffness
    mass[at, at] += shaken.mass
    held = replace(network, channel_mass=mass, mass_coupling=None, channel_stiffness=own)
    assert np.abs(np.linalg.eigvals(stepped(held))).max() == pytest.approx(shaken.growth, abs=1e-9)
    worst = any_hand.worst_hand((0.0, 1.0), (0.0, shaken.stiffness))
    assert worst is not None
    assert worst.spectral_radius >= shaken.growth - 1e-6


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"ends": [[0, -1]]}, "a network has ends or rows, not both"),
        ({"rows": [[1.0, 0.0, 0.0]]}, "rows has to be a matrix of finite numbers with 2 columns"),
        ({"rows": [[1.0, math.nan]]}, "rows has to be a matrix of finite numbers"),
        ({"rows": [["a", "b"]]}, "rows has to be an array of numbers"),
        ({"pulls": [X, Y]}, "pulls has 2 rows, but it has to have 1"),
        ({"rows": None, "stiffness": [], "damping": [], "pulls": [X]}, "pulls and link_of_row need rows"),
        ({"link_of_row": [0, 1]}, "link_of_row has 2 elements, but there are 1 links"),
        ({"stiffness": [1.0, 2.0]}, r"stiffness has shape \(2,\)"),
        ({"point_mass": [0.1], "rows": [[1.0, 0.0, -1.0]], "implicit": [True]}, "implicit masses take ends"),
        ({"channel_mass": [[0.2, 0.05], [0.04, 0.3]]}, "have to be a symmetric matrix"),
        ({"channel_mass": [[0.2, 0.3], [0.3, 0.2]]}, "have to be a positive definite matrix"),
        ({"channel_mass": [[0.2, 0.3]]}, "channel_mass has to be a matrix of finite numbers with 1 columns"),
        ({"channel_mass": [[0.0, 0.3], [0.3, 0.2]]}, r"channel_mass\[0\] is 0"),
        ({"channel_mass": COUPLED, "ahead": Ahead(1.0)}, "mass_coupling takes no ahead"),
    ],
)
def test_what_does_not_fit_is_refused_with_words(changed: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        plane(**({"rows": [X], "stiffness": [2000.0], "damping": [5.0]} | changed))


def test_a_planar_scene_is_never_large_and_no_simple_test_proves_it_stable() -> None:
    masses = 520
    rows = np.eye(2 + masses)
    network = plane(rows, [100.0] * len(rows), [0.1] * len(rows), point_mass=[0.01] * masses, delay=0.0)
    assert not is_large(network)
    unknown = margins_of(replace(network, link_of_row=np.arange(len(rows)) // 2), poles=np.zeros(1, complex))
    assert unknown.method == "none was worked out: the scene has too many masses in the plane"
    assert len(unknown.links) == len(rows) // 2
    alone = plane([[1.0, -1.0]], [100.0], [0.1], channel_mass=[], channel_friction=[], point_mass=[0.1, 0.1])
    assert not proves_stability(alone)
