"""The loop of several ports, in virtual time: two hands tied across two clocks, and what the end of a port does to the
other.

The tied motion of two hands of 0.2 kg is that of one spring and damper on 0.1 kg; both together coast on their own
friction."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from hapsim.loop import endings
from hapsim.loop.guards.energy_guard import ENERGY_EXCEEDED
from hapsim.loop.guards.travel import OUT_OF_TRAVEL
from hapsim.loop.ring import FADED
from tests.attempts import attempts
from tests.loop.joint_rig import FINE, push, run_ports, virtual_scene

Floats = NDArray[np.float64]

PUSHED = {"left": push(5.0)}
PERIOD_S = 1e-3
REDUCED = 0.1  # kg


def motions(position: Floats, first: int = 40, last: int = 340) -> NDArray[np.complex128]:
    """The three motions about a place of rest that a hand of two shows, 1/s: Prony's method on its own samples."""
    y = position[first:last] - position[first:last].mean()
    y /= np.abs(y).max()
    table = np.column_stack([y[2 - i : y.size - 1 - i] for i in range(3)] + [np.ones(y.size - 3)])
    poles = np.roots([1.0, *-np.linalg.lstsq(table, y[3:])[0][:3]])
    return np.asarray(np.log(poles.astype(complex)) / PERIOD_S)


def tied(position: Floats) -> tuple[float, float, float]:
    """k, b of the tied motion, and the decay of the common one, 1/s."""
    found = motions(position)
    swing = next(one for one in found if one.imag > 1.0)
    alone = next(one.real for one in found if abs(one.imag) < 1.0)
    return REDUCED * abs(swing) ** 2, -2.0 * REDUCED * swing.real, float(alone)


@pytest.mark.parametrize("phase", [0.0, 0.1, 0.25, 0.5, 0.75, 0.999])
@pytest.mark.parametrize("hand", ["left", "right"])
def test_both_hands_feel_the_spring_of_two_clocks(phase: float, hand: str) -> None:
    run = run_ports(virtual_scene(phase=phase), 0.35, PUSHED)
    k, b, together = tied(run.traces[hand].position[:, 0])
    assert 2177.511 - 0.005 < k < 2180.764 + 0.005
    assert 2.50485 - 2e-5 < b < 2.50494 + 2e-5
    assert -4.9814 - 1e-4 < together < -4.9751 + 1e-4


def swing_after(stiffness: float) -> float:
    """The tied motion's size after half a second over that before; the phase is the worst."""
    run = run_ports(virtual_scene(stiffness, phase=0.5), 1.1, {"left": push(0.5)})
    apart = np.diff(np.column_stack([run.traces[name].position[:1000, 0] for name in run.traces]))
    apart = apart - np.convolve(apart[:, 0], np.ones(40) / 40, "same")[:, None]
    return float(np.ptp(apart[800:900]) / np.ptp(apart[300:400]))


def test_stability_ends_where_that_of_two_clocks_does() -> None:
    assert swing_after(3400.0) < 0.95
    assert swing_after(3480.0) > 1.05


def test_positions_are_taken_in_the_order_of_their_times() -> None:
    run = run_ports(virtual_scene(phase=0.25, ppm=-1000.0), 1.2)
    left, right = (run.traces[name].time_ns for name in ("left", "right"))
    np.testing.assert_array_equal(left, np.arange(left.size) * 1_000_000)
    np.testing.assert_allclose(np.diff(right), 1e6 / 0.999, atol=1.0)
    assert right[0] == 250_000
    assert abs(int(left[-1]) - int(right[-1])) <= 2_000_000


@pytest.mark.parametrize(("leader", "phase"), [("left", 0.3), ("right", 0.6)])
def test_simulated_masses_move_with_the_leader(leader: str, phase: float) -> None:
    """A ball on a spring to each hand, worked out from the recorded positions: the leader's tick takes the follower's
    newest two positions, and the follower's tick lies between two positions of the ball."""
    points = {name: {"type": "device", "of": of, "channel": 0} for name, of in (("a", "left"), ("b", "right"))}
    spring: dict[str, Any] = {"type": "viscoelastic", "stiffness": 400, "damping": 1}
    springs = {f"to_{name}": spring | {"between": [name, "ball"]} for name in points}
    modules = points | {"ball": {"type": "mass", "mass": 0.1, "position": 0.01}} | springs
    run = run_ports(virtual_scene(phase=phase, modules=modules, leader=leader), 0.3, PUSHED)
    follower = "right" if leader == "left" else "left"
    own, other = (run.traces[name].position[:, 0] for name in (leader, follower))
    late = phase if leader == "right" else -phase  # of the leader's ticks behind the follower's of the same number
    age, newest = late % 1.0, math.floor(late)
    ball = [0.01, 0.01]  # from a sample before the first
    asked, forces = [], []
    stretched = np.zeros(2)
    for n in range(250):
        last, before = (other[max(n + newest - i, 0)] for i in range(2))
        apart = np.array([own[n], last + age * (last - before)]) - ball[-1]
        stretched = apart if n == 0 else stretched
        each = 400.0 * apart + 1.0 / PERIOD_S * (apart - stretched)
        asked.append(-each[0])
        ball.append(2.0 * ball[-1] - ball[-2] + PERIOD_S**2 / 0.1 * each.sum())
        stretched = apart
    at = (np.arange(250) - late) + 1.0  # of the follower's ticks among the ball's positions
    seen = np.interp(at, np.arange(len(ball)), ball)
    apart = seen - other[:250]
    forces = 400.0 * apart + 1.0 / PERIOD_S * np.diff(apart, prepend=apart[0])
    np.testing.assert_allclose(run.traces[leader].asked_force[:250, 0], asked, atol=1e-6)
    np.testing.assert_allclose(run.traces[follower].asked_force[2:250, 0], forces[2:], atol=1e-6)


@pytest.mark.parametrize("clocks", [{}, {"phase": 0.4, "ppm": 1000.0}])
def test_a_port_that_fails_releases_the_other(clocks: dict[str, float]) -> None:
    scene = virtual_scene(left={"travel": [-0.05, 0.05]}, **clocks)
    run = run_ports(scene, 3.0, {"left": push(9.0, 400)})
    assert run.endings == {"left": OUT_OF_TRAVEL, "right": endings.OTHER_PORT}
    right = run.traces["right"]
    assert right.report.ending == "another port ended"
    lowered = np.flatnonzero(right.flags & FADED)
    forces, asked = np.abs(right.force[lowered, 0]), np.abs(right.asked_force[lowered, 0])
    ramp = 0.5 * run.loops["right"].control.time_to_live
    assert lowered.size == ramp
    np.testing.assert_allclose(forces, np.minimum(asked, 10.0) * (1.0 - np.arange(1, ramp + 1) / ramp), atol=1e-6)
    assert asked[0] > 1.0
    assert {*run.released} == {"left", "right"}


def test_a_run_that_ends_as_asked_ends_all_ports_at_once() -> None:
    run = run_ports(virtual_scene(ppm=1000.0), 1.0, PUSHED)
    assert {*run.endings.values()} == {endings.DONE}
    assert not any(np.any(one.flags & FADED) for one in run.traces.values())
    assert [one.sample.size for one in run.traces.values()] == [999, 1000]


def test_long_runs_lose_no_row() -> None:
    run = run_ports(virtual_scene(phase=0.3), 70.0)
    for one in run.traces.values():
        np.testing.assert_array_equal(one.sample[:60000], np.arange(60000))
        assert one.report.dropped_rows == 0


def test_terminals_in_virtual_time_give_the_rows_of_memory() -> None:
    scene = virtual_scene(phase=0.3, ppm=400.0)
    one, other = (run_ports(scene, 0.3, PUSHED, transport=kind) for kind in ("terminal", "loopback"))
    for name in scene.ports:
        for column in ("sample", "time_ns", "position_counts", "force_counts", "asked_force"):
            values = [getattr(run.traces[name], column) for run in (one, other)]
            np.testing.assert_array_equal(*values)


def test_energy_that_another_hand_gives_is_no_fault_of_the_scene() -> None:
    """The right hand is pushed hard, and throws the left one, whose guard sees energy that its own hand never had."""
    pushed = {"right": push(8.0, 250)}
    run = run_ports(virtual_scene(phase=0.3, mock={"quantum": 1e-8}), 0.6, pushed, judges_energy=True)
    assert {*run.endings.values()} == {endings.DONE}
    thrown = np.diff(run.traces["left"].position[:, 0]).max() / PERIOD_S
    assert 0.1 * thrown**2 > 3.0 * run.loops["left"].record.energy_guard.limit[0]


def test_energy_guard_stops_what_swings_across_ports() -> None:
    run = run_ports(virtual_scene(6000.0, phase=0.3), 6.0, {"left": push(5.0)}, judges_energy=True)
    assert ENERGY_EXCEEDED in run.endings.values()


@pytest.mark.parametrize(("phase", "rule"), [(0.0, 14.0), (0.5, 6.5), (0.999, 2.0)])
def test_noise_of_one_hand_reaches_the_damper_of_the_other(phase: float, rule: float) -> None:
    """The sum of squares of 1 + a, -(1 + 2 a), a, for a position that is a samples old. The right one is sampled a
    phase after the left one, whose link takes it one less that later."""
    noise, damping = 1e-5, 5.0
    clock = {"clock_ppm": 0.0, "phase": phase}
    mocks = {"left": FINE, "right": FINE | {"noise": noise} | clock}
    device = {"mass": 1e6}  # at rest
    run = run_ports(virtual_scene(1e-3, damping, mocks=mocks, device=device), 8.0)
    force = run.traces["left"].asked_force[100:, 0]
    assert np.std(force) == pytest.approx(math.sqrt(rule) * noise * damping / PERIOD_S, rel=0.04)


def test_clock_of_the_host_gives_both_hands_one_position_in_time() -> None:
    """In real time. Both positions of a tick are taken together, so the spring pulls both ends alike."""
    scene = virtual_scene(device={"clock": "host"}, mock={"quantum": 1e-8})
    for _ in attempts():  # a busy machine may hold the host up for all of the push
        run = run_ports(scene, 0.4, PUSHED, transport="auto")
        assert {*run.endings.values()} == {endings.DONE}
        left, right = (one.asked_force[:, 0] for one in run.traces.values())
        count = min(left.size, right.size)
        pairs = {*np.round(left[:count], 9)} & {*np.round(-right[:count], 9)}
        if len(pairs) > 20:  # others: a position that came after the next tick
            break
    assert len(pairs) > 20
    assert np.abs(left).max() > 0.5


def test_devices_pace_in_real_time() -> None:
    scene = virtual_scene(device={"clock": "device"}, mock={"quantum": 1e-8})
    for _ in attempts():  # a busy machine may hold the host up for all of the push
        run = run_ports(scene, 0.4, PUSHED, transport="auto")
        assert {*run.endings.values()} == {endings.DONE}
        assert all(np.all(np.diff(one.sample) > 0) for one in run.traces.values())
        if (least := min(np.abs(one.asked_force).max() for one in run.traces.values())) > 0.5:
            break
    assert least > 0.5
