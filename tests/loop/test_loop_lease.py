"""A lease runs out in the loop by itself, in time, and the fallback's force takes over as STABILITY.md says."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from loop_rig import arrive, assembled, frame
from loop_rig import scene_of as wired_scene

from hapsim.cordis.offline import start, tick
from hapsim.cordis.program import compile_scene, positions_of
from hapsim.errors import UsageError
from hapsim.loop.lease import FADE_S
from hapsim.prediction.mixture import braked
from hapsim.running.changes import LiveScene
from hapsim.running.session_options import RunOptions
from hapsim.scene import Scene
from tests.running.live_structures import BEGIN, Modules, Runner, running, scene_of

LEASE_S = 0.05
WALL: Modules = {"wall": {"type": "ground"}}
ROD: dict[str, Any] = {"type": "viscoelastic", "between": ["hand", "bob"], "stiffness": 150.0, "damping": 0.5}
AWAY: Modules = WALL | {
    "palm": {"type": "device", "channel": 0},
    "thumb": {"type": "device", "channel": 1},
    "bob": {"type": "mass", "mass": 0.03, "position": 0.004},
    "rod": ROD | {"between": ["palm", "bob"]},
    "stop": {"type": "viscoelastic", "between": ["palm", "wall"], "stiffness": 80.0, "damping": 2.0},
}
"""A fallback with a mass; its hand has another name."""


@pytest.fixture
def runner(monkeypatch: pytest.MonkeyPatch) -> Iterator[Runner]:
    with running(scene_of(BEGIN), monkeypatch) as made:
        made.go()
        yield made


def eased(s: float) -> float:
    return s * s * (3.0 - 2.0 * s)


def run_until_out(runner: Runner) -> int:
    """Runs until the lease has run out; returns the index of that row."""
    for _ in range(10):
        runner.go()
        if runner.live.lease.is_out:
            break
    *_, sample = runner.live.lease.new_ends()
    return int(np.flatnonzero(runner.sample == sample)[0])


def forces_of(scene: Scene, position: np.ndarray, before: np.ndarray) -> np.ndarray:
    """The forces of a scene that begins with its hands at `before`, (N, channels) N."""
    program, force, still = compile_scene(scene), np.zeros_like(position), np.zeros(position.shape[1])
    start(program, before)
    for n, measured in enumerate(position):
        tick(program, measured, still, force[n])
    return force


@pytest.mark.thorough(keep=2)
@pytest.mark.parametrize("seed", range(4))
def test_it_runs_out_at_the_first_position_at_or_after_its_end(seed: int) -> None:
    """Some positions are late and some are lost; the fade lasts FADE_S all the same."""
    chance = np.random.default_rng(seed)
    scene = wired_scene(device={"clock": "device"})
    loop = assembled(scene)
    live = LiveScene(scene, loop)
    now, number, weights, length = 0, 0, [0.0], float(chance.uniform(0.01, 0.1))
    begun, samples_at, times = None, [0], [0]
    for step in range(400):
        if step == 5:
            assert live.ask_for_lease(length) == "begun"
        gap = int(chance.integers(2, 9)) if chance.random() < 0.1 else 1
        number += gap
        now += gap * 1_000_000 + int(chance.integers(-200_000, 200_000))
        arrive(loop, frame(number, 1000), now)
        if step == 5:
            begun = now
        weights.append(live.lease.weight)
        samples_at.append(number)
        times.append(now)
    assert begun is not None
    first = int(np.flatnonzero(np.array(weights) > 0.0)[0])
    assert first == int(np.flatnonzero(np.array(times) >= begun + round(length * 1e9))[0])
    since = np.array(samples_at) - samples_at[first - 1]
    expected = [eased(min(max(n / (FADE_S * 1000.0), 0.0), 1.0)) for n in since]
    assert np.allclose(weights, expected, atol=1e-9)


def test_the_force_fades_to_that_of_the_fallback_which_begins_where_the_hands_are(runner: Runner) -> None:
    fallback = scene_of(AWAY)
    runner.live.ask_for_lease(LEASE_S, fallback)
    first = run_until_out(runner)
    assert runner.sample[first] == 65 + round(LEASE_S * 1000)
    runner.go()
    position, used = runner.position, slice(first, runner.rows)
    alone = forces_of(scene_of(BEGIN), position, position[0])
    other = forces_of(fallback, position[used], position[first - 1])
    weight = np.array([eased(min((n + 1) / (FADE_S * 1000), 1.0)) for n in range(runner.rows - first)])[:, None]
    assert np.allclose(runner.asked[:first], alone[:first], atol=1e-12)
    assert np.allclose(runner.asked[used], alone[used] + weight * (other - alone[used]), atol=1e-9)
    assert np.abs(other[-1] - alone[-1]).max() > 1e-3


def test_a_ramp_and_a_crossfade_under_way_do_not_delay_it(runner: Runner) -> None:
    runner.live.set({"nail": {"stiffness": 900.0}}, over=1e5)
    runner.go()
    runner.live.adopt(scene_of({name: one for name, one in BEGIN.items() if name != "rest"}), over=1e5)
    runner.live.ask_for_lease(LEASE_S)
    first = run_until_out(runner)
    runner.go()
    assert runner.sample[first] == 2 * 65 + 50
    assert runner.live.lease.weight == 1.0
    assert runner.loop.is_replacing
    brake = braked(runner.live.scene)
    position = runner.position
    expected = forces_of(brake, position[first:], position[first - 1])
    after = round(FADE_S * 1000)
    assert np.allclose(runner.asked[first + after :], expected[after:], atol=1e-9)


def test_a_renewal_in_time_changes_nothing(runner: Runner) -> None:
    for _ in range(6):
        assert runner.live.ask_for_lease(0.08) in ("begun", "")
        runner.go()
    assert (runner.live.lease.weight, runner.live.lease.is_out) == (0.0, False)
    position = runner.position
    assert np.allclose(runner.asked, forces_of(scene_of(BEGIN), position, position[0]), atol=1e-12)
    assert [note["tick"] for note in runner.live.take_notes()] == [65 * n for n in range(1, 7)]


def test_a_renewal_turns_the_fade_round_and_the_next_fallback_begins_anew(runner: Runner) -> None:
    fallback = scene_of(AWAY)
    runner.live.ask_for_lease(0.1, fallback)
    runner.go()
    runner.go()
    weight = runner.live.lease.weight
    assert 0.0 < weight < 1.0, "the fade is under way"
    assert runner.live.lease.renew() == "renewed"
    runner.go()
    assert runner.live.ask_for_lease(0.1) == "", "in time"
    assert runner.live.lease.weight == 0.0
    first = run_until_out(runner)
    runner.go()
    position, used = runner.position, slice(first, runner.rows)
    other = forces_of(fallback, position[used], position[first - 1])
    settled = round(FADE_S * 1000)
    assert np.allclose(runner.asked[used][settled:], other[settled:], atol=1e-9)


@pytest.mark.parametrize("seconds", [10.0, None])
def test_a_request_counts_before_the_loop_has_taken_it(runner: Runner, seconds: float | None) -> None:
    runner.live.ask_for_lease(LEASE_S)
    run_until_out(runner)
    with pytest.raises(UsageError, match="the lease has run out"):
        runner.live.lease.require_kept()
    runner.live.ask_for_lease(seconds)
    runner.live.lease.require_kept()
    runner.go()
    runner.live.lease.require_kept()


def test_an_ended_lease_gives_the_scene_back_for_good(runner: Runner) -> None:
    runner.live.ask_for_lease(LEASE_S)
    run_until_out(runner)
    assert runner.live.ask_for_lease(None) == "ended"
    for _ in range(4):
        runner.go()
    assert (runner.live.lease.weight, runner.live.lease.is_out, runner.live.lease.seconds) == (0.0, False, None)
    assert runner.live.ask_for_lease(LEASE_S, scene_of(AWAY)) == "begun", "with another fallback"
    run_until_out(runner)


def test_a_request_that_is_half_written_begins_nothing(runner: Runner) -> None:
    runner.live.ask_for_lease(1.0)
    runner.go()
    runner.live.ask_for_lease(None)
    runner.go()
    runner.live.lease._own.length = 1  # as by a thread that is interrupted before it counts its request
    runner.go()
    assert [*runner.live.lease.new_ends()] == []
    assert (runner.live.lease.weight, runner.live.lease.is_out) == (0.0, False)


def test_it_belongs_to_who_asked_until_it_runs_out(runner: Runner) -> None:
    lease = runner.live.lease
    lease.ask(0.1, owner="one")
    for ask in (lambda: lease.ask(1.0, owner="two"), lambda: lease.ask(None), lambda: lease.renew("two")):
        with pytest.raises(UsageError, match="another client holds the lease"):
            ask()
    run_until_out(runner)
    with pytest.raises(UsageError, match="renew the lease"):
        lease.require_kept()
    assert lease.renew("two") == "renewed"
    runner.go()
    with pytest.raises(UsageError, match="another client"):
        lease.ask(1.0, owner="two")
    lease.renew("one")
    run_until_out(runner)
    assert lease.ask(1.0, owner="two") == "renewed"


@pytest.mark.thorough(keep=3)
@pytest.mark.parametrize(
    ("seconds", "fallback", "message"),
    [
        (0.001, None, "found 0.001 s, expected 0.005 to 3600"),
        (float("nan"), None, "found nan s"),
        (1.0, {"rate": 2000.0}, "another rate"),
        (1.0, {"scheme": "rk4"}, "another scheme"),
        (1.0, {"device": {"mass": 0.3, "friction": 2.0, "clock": "lockstep"}}, "another device.mass"),
        (1.0, {"stiffness": 1e6}, "predicted unstable"),
    ],
)
def test_what_cannot_be_a_fallback_is_refused(
    seconds: float, fallback: dict[str, Any] | None, message: str, runner: Runner
) -> None:
    wanted = None
    if fallback is not None:
        stop = AWAY["stop"] | {"stiffness": fallback.pop("stiffness", 80.0)}
        wanted = scene_of(AWAY | {"stop": stop}, **fallback)
    with pytest.raises(UsageError, match=message):
        runner.live.ask_for_lease(seconds, wanted)
    assert runner.live.lease.seconds is None
    for _ in range(3):
        runner.go()
    assert runner.live.lease.weight == 0.0


@pytest.mark.parametrize(
    ("device", "message"),
    [
        ({"correction": "predictor"}, "device.correction: found predictor, expected none, poles or sensed"),
        ({"law": "board", "board_rate": 10000.0}, "device.law: found board, expected host"),
    ],
)
def test_a_scene_from_which_none_can_take_over_is_refused(device: dict[str, Any], message: str) -> None:
    scene = wired_scene(device=device)
    loop = assembled(wired_scene())
    with pytest.raises(UsageError, match=message):
        LiveScene(scene, loop).ask_for_lease(1.0)


def test_the_tank_pays_for_a_fallback_that_adds_energy() -> None:
    """A hand 5 mm inside a spring of 2000 N/m that the fallback adds: 25 mJ, of a tank that has fewer."""
    scene = wired_scene(stiffness=0.0, damping=3.0, device={"clock": "device", "force_limit": 10.0})
    loop = assembled(scene, options=RunOptions(judges_energy=True))
    live, tank = LiveScene(scene, loop), loop.record.tank
    tank.level, tank.capacity, tank.refill = 0.004, 1.0, 0.0
    live.ask_for_lease(
        0.01, wired_scene(stiffness=2000.0, damping=3.0, device={"clock": "device", "force_limit": 10.0})
    )
    for n in range(1, 300):
        arrive(loop, frame(n, 5000), n * 1_000_000)
    stored = 0.5 * 2000.0 * 0.005**2
    assert live.lease.weight == pytest.approx(0.004 / stored, rel=1e-6)
    assert tank.spent == pytest.approx(0.004, rel=1e-9)
    tank.level = 1.0
    for n in range(300, 400):
        arrive(loop, frame(n, 5000), n * 1_000_000)
    assert live.lease.weight == 1.0
    assert tank.spent == pytest.approx(stored, rel=1e-9)


def test_masses_end_where_their_scene_has_them(runner: Runner) -> None:
    """The fallback does not move before it is needed."""
    runner.live.ask_for_lease(1e3, scene_of(AWAY))
    runner.go()
    fallback = runner.loop.fallback
    assert fallback is not None
    assert positions_of(fallback)[0][fallback.numbers["bob"]] == 0.004
