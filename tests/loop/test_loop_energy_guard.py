"""The energy guard: what no passive object does ends the run, and nothing that one does."""

from __future__ import annotations

import contextlib
import json
import math
import sys
import threading
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from loop_rig import run_with_loop, served

from firmware_protocol import schema
from firmware_protocol.compiled import new_record
from hapsim.compiling import entry
from hapsim.compiling.native import address_of
from hapsim.cordis.stored_energy import TANK, Tank
from hapsim.errors import DeviceError, GuardError
from hapsim.loop.buffers import IO_BUFFER
from hapsim.loop.force_history import FORCE_HISTORY, history_hook, keep
from hapsim.loop.guards.energy_guard import (
    ENERGY_GUARD,
    GIVEN,
    GUARD,
    LATE,
    SCENE,
    SHAKES,
    SHAKING,
    SWINGING,
    SWINGS,
    is_strict,
    judge_energy,
    set_predicted_unstable,
)
from hapsim.loop.hooks import TICK, call_hook
from hapsim.running import Excitation, PeriodicExcitation, changes, run, start
from hapsim.scene import Scene, parse_scene
from tests.one_hand import scene_of

sys.path.append(str(Path(__file__).resolve().parents[2] / "tools" / "bench"))

from energy_guard import Drawn, Stalling, judged, knocks, passive_scenes, unstable_scenes

T = 1e-3
FEW = 10


@pytest.fixture(scope="module")
def unstable() -> list[Drawn]:
    return list(unstable_scenes(FEW, seed=7))


@pytest.fixture(scope="module")
def passive() -> list[Drawn]:
    return list(passive_scenes(FEW, seed=7))


@pytest.mark.thorough(keep=4)
@pytest.mark.parametrize("number", range(FEW))
def test_what_diverges_is_ended_before_the_hand_had_more_than_its_limit(unstable: list[Drawn], number: int) -> None:
    outcome = judged(unstable[number])
    assert outcome.is_ended
    assert outcome.is_within


@pytest.mark.parametrize("number", range(FEW))
def test_no_hand_on_a_passive_object_is_stopped(passive: list[Drawn], number: int) -> None:
    assert judged(passive[number]).ending == "done"


@pytest.mark.thorough(keep=2)
@pytest.mark.parametrize("number", range(4))
def test_no_passive_object_is_blamed_for_a_stalling_host_and_knocks(passive: list[Drawn], number: int) -> None:
    outcome = judged(passive[number]._replace(duration=1.0), stalls=number)
    assert outcome.ending == "done" or outcome.is_late


@pytest.mark.thorough(keep=1)
@pytest.mark.parametrize("stalls", [False, True])
def test_a_spring_just_within_passivity_is_not_blamed_for_knocks_and_stalls(stalls: bool) -> None:
    """The spring has exactly the friction that it needs: the energy gained between crossings must be read at one
    place."""
    scene = wall(666.0, delay=1.0)
    between = {"between": lambda device: Stalling(device, seed=1)} if stalls else {}
    pushes = knocks(scene, 20.0, seed=1)
    assert run(scene, duration=3.0, judges_energy=True, excitation=pushes, **between).report.ending == "done"


@pytest.mark.thorough
def test_the_energy_of_late_forces_is_reported_as_theirs() -> None:
    """Just within passivity in time, and stalled for a quarter of it."""
    scene = wall(600.0)
    with pytest.raises(GuardError, match=r"the force swung at its limit: 64 times in a row") as caught:
        run(
            scene,
            duration=20.0,
            judges_energy=True,
            excitation=knocks(scene, 20.0, seed=1),
            between=lambda device: Stalling(device, seed=1, every=40.0),
        )
    late = caught.value.trace.report.deadline_misses
    assert f"{late} forces were up to 18 ms late; in time the scene would have given no more" in str(caught.value)
    assert "no passive object" not in str(caught.value).lower()


def wall(stiffness: float = 20_000.0, *, clock: str = "lockstep", velocity: float = 0.1, **device: Any) -> Scene:
    """A hand on a spring, unstable where it is stiff."""
    spring = {"type": "spring", "between": ["hand", "wall"], "stiffness": stiffness}
    return scene_of({"touch": spring}, device={"clock": clock, **device}, mock={"initial": {"velocity": velocity}})


def test_the_device_is_disarmed_and_the_sentence_states_what_was_given() -> None:
    with served(wall(energy_limit=0.05, friction=0.0)) as (scene, mock):
        with pytest.raises(GuardError) as caught:
            run(scene, duration=60.0)
        assert mock.board.state == schema.IDLE
        assert not mock.commands.any()
    assert caught.value.exit_status == 4
    assert "that is meant to give energy, set device.energy_limit" in str(caught.value)
    assert "the scene had given the hand 0.05" in str(caught.value)
    assert "above the limit of 0.05 J; the last force was not sent. No passive object does that" in str(caught.value)
    assert "the force is zero: the device confirmed that it released it" in str(caught.value)
    trace = caught.value.trace
    assert trace.report.ending == "scene diverging"


def test_a_large_energy_limit_ends_a_swing_at_the_limit_too() -> None:
    with pytest.raises(GuardError, match=r"its limit: 16 times in a row, .* above the limit of 0.2 J") as caught:
        run(wall(energy_limit=1e6), duration=5.0)
    assert "slew_limit" not in str(caught.value)
    assert "A larger device.energy_limit does not change that" in str(caught.value)


def test_where_the_slew_limit_held_the_force_back_it_is_named_first() -> None:
    with pytest.raises(GuardError, match=r"device.slew_limit held the force back in .* No passive object does that"):
        run(wall(2000.0, friction=6.0, slew_limit=100.0), duration=2.0, judges_energy=True)


def test_before_the_mock_it_is_off_until_it_is_asked_for() -> None:
    assert run(wall(), duration=5.0).report.ending == "done"
    with pytest.raises(GuardError):
        run(wall(), duration=5.0, judges_energy=True)


@pytest.mark.parametrize(("clock", "judges"), [("host", True), ("device", True), ("lockstep", False)])
def test_it_is_the_default_before_a_port_but_in_virtual_time(clock: str, judges: bool) -> None:
    limits = []

    def note(session: Any) -> None:
        energy = session._loop.record.energy_guard
        limits.append(float(energy.limit[SCENE]) if energy.tank else None)
        session.stop()

    with (
        served(wall(200.0, clock=clock)) as (scene, _),
        contextlib.suppress(DeviceError),  # of a machine that is held up
        start(scene, duration=0.01, on_arming=note),
    ):
        pass
    assert limits == [pytest.approx(0.2) if judges else None]


@pytest.mark.parametrize("periodic", [False, True])
def test_what_an_excitation_gives_the_hand_is_the_hand_s(periodic: bool) -> None:
    """It sends the hand off at several metres a second, with a hundred times what the scene may give."""
    pushes: Any = Excitation(channel=0, force=5.0, ticks=200, every=10_000, start=10_000, first=True)
    if periodic:
        pushes = PeriodicExcitation(channel=0, forces=np.repeat([5.0, -5.0], 150))
    scene = wall(20.0, energy_limit=0.002, friction=0.5)
    assert run(scene, duration=0.6, excitation=pushes).report.ending == "done"


@pytest.mark.parametrize("sampling", ["ideal", "average"])
@pytest.mark.parametrize("hold", ["zoh", "impulse"])
def test_what_it_counts_is_the_energy_of_the_hand(hold: str, sampling: str) -> None:
    """On a spring behind a delay, without friction, from one sample of a swing that grows to another."""
    scene = wall(5000.0, friction=0.0, delay=1.0, hold=hold, sampling=sampling, energy_limit=1e6)
    counted, kinetic = [], []
    for samples in (40, 63):
        x = run(scene, duration=(samples + 1) * T).position[:, 0]
        _, loop = run_with_loop(scene, duration=samples * T)
        counted.append(float(loop.record.energy_guard.given[SCENE]))
        kinetic.append(0.5 * 0.2 * ((x[samples] - x[samples - 2]) / (2.0 * T)) ** 2)
    assert np.diff(counted) == pytest.approx(np.diff(kinetic), rel=0.03)


# The guard alone, told of forces and positions.


@entry
def first_trip(hooks, energy, tick, io, positions, stiffness, damping, limit):
    """At which sample the guard trips, of a spring and a backward damper at these positions (m); -1 if never. Also the
    most energy that it counts."""
    before, most = positions[0], -1e300
    for n in range(positions.size):
        io.position_counts[0] = positions[n]
        asked = -stiffness * positions[n] - damping * (positions[n] - before) / T
        before = positions[n]
        io.asked[0] = asked
        io.force_counts[0] = max(min(asked, limit), -limit)
        call_hook(hooks[0], (hooks[1], tick.address))
        if call_hook(hooks[2], (hooks[3], tick.address)) != 0:
            return n, most
        most = max(most, energy.given[0])
    return -1, most


def judge(
    positions: Any,
    *,
    stiffness: float,
    damping: float = 0.0,
    friction: float,
    delay: float,
    limit: float = 1e9,
    energy: float = 1e12,
    unstable: bool = False,
    gap: int = 1,
    late: bool = False,
) -> tuple[int, float, int, int]:
    """(the sample at which it trips, the most energy that the scene's account has, why, by which account). Counts are
    of 1 m and 1 N."""
    record, history, io = new_record(ENERGY_GUARD), new_record(FORCE_HISTORY), new_record(IO_BUFFER)
    tick = new_record(TICK)
    io.channels, tick.gap, tick.late = 1, gap, late
    tick.address, tick.io, tick.history = address_of(tick), address_of(io), address_of(history)
    io.position_scale[0] = io.force_scale[0] = 1.0
    io.force_limit[0] = limit
    scale = SimpleNamespace(energy=energy, credit=1e15)
    device = SimpleNamespace(
        force_limit=1.0, is_admittance=False, scales=lambda _: [scale], frictions=lambda _: [friction]
    )
    setting: Any = SimpleNamespace(
        scene=SimpleNamespace(channels=1, rate=1.0 / T, device=device, scaled_links={}, away=()),
        bounds=SimpleNamespace(energy_limit=energy),
    )
    GUARD.set_up(SimpleNamespace(energy_guard=record, tank=(tank := new_record(TANK))), setting)
    Tank(tank, capacity_j=0.0, refill_j=0.0)
    record.limit[:] = energy
    set_predicted_unstable(record, unstable=unstable)
    kept = history_hook(history, delay=delay, keeps_last_force=True)
    hooks = [keep.address(), address_of(history), judge_energy.address(), address_of(record)]
    told = np.asarray(positions, np.int64), stiffness, damping, limit
    row, most = first_trip(np.array(hooks, np.uint64), record, tick, io, *told)
    del kept
    return int(row), float(most), int(record.why), int(record.account)


@pytest.mark.parametrize("delay", [0.0, 0.37, 1.0, 2.5])
@pytest.mark.parametrize("damping", [0.0, 3000.0, -3000.0])
def test_with_the_friction_of_the_docstring_no_motion_is_given_energy(delay: float, damping: float) -> None:
    """Whatever the positions are. What a spring held at the beginning is nothing here: they begin at rest in its
    middle."""
    chance, stiffness = np.random.default_rng(2), 1_000_000.0
    friction = stiffness * T * (0.5 + delay) + abs(damping)
    for _ in range(30):
        positions = np.concatenate([np.zeros(8), np.cumsum(chance.integers(-40, 41, 300))])
        most = judge(positions, stiffness=stiffness, damping=damping, friction=friction, delay=delay)[1]
        assert most <= 1e-3


@pytest.mark.parametrize(("gap", "late"), [(1, True), (3, False)])
def test_nor_where_forces_are_late_or_positions_lost(gap: int, late: bool) -> None:
    """The scene's account counts what its forces would have done in time. The other counts those that acted: with a
    sample more of delay this friction is too little."""
    chance, stiffness = np.random.default_rng(3), 1_000_000.0
    positions = np.concatenate([np.zeros(8), np.cumsum(gap * chance.integers(-40, 41, 3000))])
    told: dict[str, Any] = {"stiffness": stiffness, "friction": 1.5 * stiffness * T, "delay": 1.0}
    assert judge(positions, **told, gap=gap, late=late)[1] <= 1e-3
    shaken = np.rint(1e6 * np.sin(2.0 * np.pi * np.arange(4000) / 30))
    trip = judge(shaken, stiffness=1000.0, friction=1.5, delay=1.0, energy=1e15, gap=gap, late=late)
    assert trip[2:] == (GIVEN, LATE)


@pytest.mark.parametrize("delay", [0.0, 1.37])
def test_over_lost_positions_it_counts_what_there_is_along_the_line(delay: float) -> None:
    """The energy matches that of a line with every position, except for a missed peak."""
    known = 3 * np.rint(1e6 * np.sin(2.0 * np.pi * np.arange(1000) / 30))
    line = np.interp(np.arange(2998) / 3.0, np.arange(1000), known)
    told: dict[str, Any] = {"stiffness": 1000.0, "friction": 0.1, "delay": delay, "limit": 1e12, "energy": 1e20}
    lost, all_there = (judge(positions, **told, gap=gap)[1] for positions, gap in ((known, 3), (line, 1)))
    assert lost == pytest.approx(all_there, rel=2e-3)


@pytest.mark.parametrize(("delay", "period"), [(0.0, 2), (1.0, 6), (2.0, 10)])
def test_with_less_a_hand_that_shakes_is_given_energy(delay: float, period: int) -> None:
    """A tenth too little friction gives the hand energy: without delay at half the rate, with it where the force lags
    most."""
    stiffness = 1000.0
    whole = stiffness * T * (0.5 + delay)
    positions = np.rint(1e6 * np.sin(2.0 * np.pi * (np.arange(4000) + 0.5) / period))
    least = 1.0 if delay == 0.0 else 0.6
    assert judge(positions, stiffness=stiffness, friction=0.9 * least * whole, delay=delay, energy=1e17)[2] == GIVEN
    assert judge(positions, stiffness=stiffness, friction=1.1 * whole, delay=delay, energy=1e17)[0] == -1


def test_a_hand_that_only_just_shakes_into_the_limit_is_not_taken_for_a_scene_that_does() -> None:
    """At 8 Hz a strong hand, at 100 Hz a scene; the peaks stay the same. Much friction, so that no energy is given."""
    time = np.arange(20_000) * T
    for hz, over, row in ((8.0, 3.0, False), (15.0, 1.3, False), (15.0, 3.0, True), (100.0, 1.2, True)):
        positions = np.rint(1e6 * np.sin(2.0 * np.pi * hz * time))
        at, _, why, _ = judge(positions, stiffness=1.0, friction=1e4, delay=1.0, limit=1e6 / over)
        assert (at >= 0) == row, (hz, over)
        if row:
            assert why == SHAKING
            assert at == pytest.approx((SHAKES + 1.5) / (2.0 * hz) / T, rel=0.1)


def test_a_swing_that_dies_away_is_none() -> None:
    time = np.arange(20_000) * T
    positions = np.rint(1e7 * np.exp(-0.5 * time) * np.sin(2.0 * np.pi * 15.0 * time))
    assert judge(positions, stiffness=1.0, friction=1e4, delay=1.0, limit=2e6)[0] == -1


def test_on_a_scene_that_is_predicted_unstable_a_swing_below_the_limit_counts() -> None:
    """A constant swing counts with just enough friction and with a little more; a decaying one does not."""
    time = np.arange(40_000) * T
    positions = np.rint(1e6 * np.sin(2.0 * np.pi * 15.0 * time))
    w = 2.0 * np.pi * 15.0
    given = math.sin(w * T * 1.5) / w  # of a force that is one and a half samples late: the friction that takes it
    swung: dict[str, Any] = {"stiffness": 1.0, "delay": 1.0, "limit": 1.5e6, "energy": 1e12}
    for friction, at_all in ((0.999 * given, True), (1.005 * given, True), (1.1 * given, False)):
        assert judge(positions, **swung, friction=friction)[2] == 0
        assert (judge(positions, **swung, friction=friction, unstable=True)[2] == SWINGING) == at_all


def test_on_such_a_scene_every_turn_from_limit_to_limit_is_shaking() -> None:
    time = np.arange(60_000) * T
    slow = np.rint(1e6 * np.sin(2.0 * np.pi * 3.0 * time))
    shaken: dict[str, Any] = {"stiffness": 1.0, "friction": 1e4, "delay": 1.0, "limit": 0.8e6}
    assert judge(slow, **shaken)[0] == -1
    at, _, why, _ = judge(slow, **shaken, unstable=True)
    assert (why, at) == (SHAKING, pytest.approx((SWINGS + 0.5) / (2.0 * 3.0) / T, rel=0.1))
    slower = np.rint(1e6 * np.sin(2.0 * np.pi * 0.8 * time))
    assert judge(slower, **shaken, unstable=True)[0] == -1


def contact(stiffness: float, clock: str = "lockstep") -> Scene:
    """A hand that the device's own spring presses on a wall, and which bounces on a wall that is too stiff, below the
    limit of the force."""
    document = wall(clock=clock).model_dump(mode="json", exclude_none=True)
    document["device"] |= {"mass": 0.27, "friction": 4.7, "stiffness": 160.0, "delay": 1.0}
    touch = {"type": "buffer", "between": ["hand", "wall"], "stiffness": stiffness, "damping": 0.5, "distance": 0.004}
    document["modules"]["touch"] = touch
    return parse_scene(json.dumps(document))


def test_a_contact_that_is_predicted_unstable_is_ended_where_it_bounces_below_the_limit() -> None:
    scene = contact(10_000.0)
    assert run(scene, duration=20.0, judges_energy=True).report.ending == "done"
    with pytest.raises(GuardError, match="swung on a scene that is predicted unstable") as caught:
        run(scene, duration=20.0, judges_energy=True, unstable=True)
    assert "`hapsim check` reports what would make the scene stable" in str(caught.value)
    after = caught.value.trace.asked_force[1000:, 0]
    assert np.abs(after).max() < scene.device.force_limit


def test_what_a_change_makes_unstable_is_judged_so_too(monkeypatch: pytest.MonkeyPatch) -> None:
    """And what a change makes stable again is not, once it is there. What is not judged yet counts as unstable."""
    judged_as, shaken_by, may_judge = [], changes.surely_shaken_by, threading.Event()

    def judged_later(scene: Scene) -> Any:
        assert may_judge.wait(60)
        return shaken_by(scene)

    monkeypatch.setattr(changes, "surely_shaken_by", judged_later)
    with start(contact(1000.0, clock="device"), judges_energy=True, unstable=True) as session:
        for stiffness, over in ((1000.0, 0.0), (10_000.0, 0.0), (1000.0, 3600.0), (1000.0, 0.0)):
            may_judge.clear()
            session.set({"touch": {"stiffness": stiffness + 1.0 - over / 3600.0}}, over=over)
            guard, live = session._loop.record.energy_guard, session._live
            assert is_strict(guard)  # it runs unjudged
            may_judge.set()
            while live._is_judging:
                session.wait(0.002)
            elapsed = int(guard.elapsed)
            while guard.elapsed < elapsed + 3:
                session.wait(0.002)
            judged_as.append(is_strict(guard))
        session.stop()
    assert judged_as == [False, True, True, False]
