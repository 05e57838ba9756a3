"""A sensor that is dead but answers takes the force away; a hand that holds a live one still keeps it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from frozen_device import FrozenDevice, after
from loop_rig import arrive, assembled, frame, scene_of, served

from hapsim.errors import GuardError
from hapsim.loop.endings import RECEIVED
from hapsim.loop.guards.frozen_sensor import MOST_RAMP_S, MOST_WAIT_S
from hapsim.loop.ring import FADED
from hapsim.recording.trace import Trace
from hapsim.running import run, start
from hapsim.running.session_options import RunOptions
from hapsim.scales import SCALES
from hapsim.scene import Scene

RATE = 1000.0
SOFT = 50  # samples of the soft start
MOST_M = 0.3  # of a free handle, until its force is zero: a `runaway`, and the way of a question after it


def guarded(scene: Scene, device: FrozenDevice | None = None, duration: float = 2.0, **options: Any) -> Trace:
    """Returns the trace of a run to its end, with force or without."""
    try:
        return run(scene, duration=duration, between=device, judges_energy=True, **options)
    except GuardError as error:
        if error.trace is None or error.trace.report.ending != "done":
            raise
        return error.trace


def lenient(**device: Any) -> dict[str, Any]:
    """A device on which the energy guard ends nothing: what is tested is that the force is gone before."""
    return {"energy_limit": 1e6, **device}


@pytest.mark.thorough(keep=2)
@pytest.mark.parametrize(
    ("died", "until", "duration", "is_told"),
    [(12, 1 << 40, 1.5, True), (12, 1 << 40, 1.0, False), (12, 1100, 1.4, False)],
)
def test_a_run_that_ends_without_force_for_a_second_has_status_4(
    tmp_path: Path, died: int, until: int, duration: float, is_told: bool
) -> None:
    scene = scene_of(mock={"initial": {"velocity": 0.5}}, device=lenient(friction=20.0))
    device, caught = FrozenDevice(after(died), until=until), None
    try:
        trace = run(scene, duration=duration, between=device, judges_energy=True, reports=tmp_path)
    except GuardError as error:
        caught, trace = error, error.trace
    assert trace is not None
    assert trace.report.ending == "done"
    assert trace.report.frozen_ticks > 100
    assert (caught is not None) is is_told
    if caught is not None:
        assert caught.exit_status == 4
        assert "ended normally after 1500 ticks, without force: the position of hand0 has not changed" in str(caught)
        assert "the position of hand0 has not changed" not in caught.shortened(["frozen"])
    assert [path.name.rpartition("_")[2] for path in tmp_path.iterdir()] == ["without-force.zip"] * is_told


def test_a_travel_that_takes_the_force_away_is_no_failure() -> None:
    device = {"travel": [-0.05, 0.05], "travel_margin": 0.02, "origin": 0.0}
    hand = {"stiffness": 1e4, "damping": 50.0, "position": 0.0695}
    scene = scene_of(mock={"initial": {"position": 0.0695, "velocity": 0.0}, "hand": hand}, device=device)
    trace = run(scene, duration=1.5, judges_energy=True)
    assert trace.report.faded_ticks == 1500
    assert np.abs(trace.force[-1]) < 0.1 * np.abs(trace.asked_force[-1])


def no_force_at_the_end(trace: Trace, channel: int = 0) -> int:
    """The first sample of the last row of samples without a force of this channel, while the scene asks for one."""
    forces = trace.force_counts[:, channel] != 0
    assert not forces[-1]
    assert np.all(np.abs(trace.asked_force[-10:, channel]) > 0.1)
    return int(np.flatnonzero(forces)[-1]) + 1


MOMENTS = {
    "at arming": ({"initial": {"position": 0.02}}, after(0)),
    "in a flick": ({"initial": {"velocity": 0.5}}, after(12)),
    "in the middle of a swing": ({"initial": {"position": 0.01, "velocity": -0.5}}, after(30)),
    "under a hand": ({"hand": {"force": 1.0, "damping": 5.0}, "noise": 2e-5, "initial": {"velocity": 0.0}}, after(300)),
}


@pytest.mark.thorough(keep=3)
@pytest.mark.parametrize("moment", MOMENTS)
@pytest.mark.parametrize(
    ("mass", "limit", "count"),
    [(0.05, 1.0, 1e-6), (0.05, 40.0, 1e-4), (0.2, 1.0, 1e-4), (1.0, 10.0, 1e-5)],
)
def test_a_dead_sensor_takes_the_force_away(mass: float, limit: float, count: float, moment: str) -> None:
    mock, dies = MOMENTS[moment]
    device = FrozenDevice(dies)
    scene = scene_of(mock={**mock, "quantum": count}, device=lenient(mass=mass, force_limit=limit))
    trace = guarded(scene, device, duration=1.0 if moment == "under a hand" else 0.8)
    gone = no_force_at_the_end(trace)
    assert device.died is not None
    died = device.died
    assert gone - died <= (MOST_WAIT_S + MOST_RAMP_S + 0.01) * RATE
    pushed = abs(float(trace.asked_force[-1, 0]))
    assert np.abs(device.way(count)[: gone - died]).max() < MOST_M
    moving = 0.5 * mass * (np.diff(device.way(count))[max(gone - died - 1, 0)] * RATE) ** 2
    at_death = 0.5 * mass * (0.6**2)
    assert moving < min(pushed, limit) * MOST_M + at_death
    report = trace.report
    assert report.sensor_tests >= 1
    assert report.frozen_ticks == report.ticks - gone
    assert np.all(trace.flags[gone:] & FADED)
    assert report.frozen.startswith("the position of hand0 has not changed by one count for ")
    assert report.frozen.count("although force acted: sensor or cable?") == 1


@pytest.mark.parametrize("count", [1e-6, 1e-5, 1e-4, 5e-4])
def test_a_hand_that_holds_a_live_encoder_still_keeps_its_force(count: float) -> None:
    """A hand without tremor stands still for seconds. The guard tests it, sees it yield by some counts, and restores
    its force."""
    hand = {"force": -5.0, "stiffness": 300.0, "damping": 5.0}
    mock = {"quantum": count, "hand": hand, "initial": {"velocity": 0.0}, "coulomb": 1000.0 * count}
    trace = guarded(scene_of(damping=1.0, mock=mock))
    assert (trace.report.frozen_ticks, trace.report.frozen) == (0, "")
    assert 1 <= trace.report.sensor_tests <= 20  # a free handle would run away within a tenth of a second
    share = np.abs(trace.force[500:, 0] / trace.asked_force[500:, 0])
    assert np.median(share) == pytest.approx(1.0, abs=1e-6)
    assert share.min() > (0.8 if count <= 1e-5 else 0.2)


@pytest.mark.parametrize("place", [0.0, 0.3])
def test_a_hand_that_trembles_is_not_asked(place: float) -> None:
    hand = {"force": -5.0, "stiffness": 300.0, "damping": 5.0, "position": place}
    mock = {"quantum": 1e-6, "noise": 2e-6, "hand": hand, "initial": {"position": place, "velocity": 0.0}}
    scene = scene_of(mock=mock).changed({"wall.position": place})
    plain = run(scene, duration=2.0)
    trace = guarded(scene)
    assert trace.report.sensor_tests == 0
    np.testing.assert_array_equal(trace.force_counts, plain.force_counts)


def test_a_sensor_that_lives_again_gets_its_force_over_the_soft_start() -> None:
    hand = {"force": -3.0, "stiffness": 300.0, "damping": 20.0}
    scene = scene_of(mock={"hand": hand, "initial": {"velocity": 0.0}, "noise": 1e-7}, device=lenient())
    device = FrozenDevice(after(200), until=900)
    trace = guarded(scene, device, duration=1.1)
    back = 200 + int(np.argmax(trace.force_counts[200:, 0] == 0))
    assert not trace.force_counts[back:901, 0].any()
    share = trace.force[901:, 0] / trace.asked_force[901:, 0]
    np.testing.assert_allclose(share[:SOFT], np.arange(1, SOFT + 1) / SOFT, atol=1e-3)
    np.testing.assert_allclose(share[SOFT:], 1.0, atol=1e-6)


def test_of_several_channels_the_dead_one_loses_its_force_and_is_named() -> None:
    mock = {"initial": {"position": [0.004, 0.004, 0.004]}}
    plain = run(scene_of(3, damping=4.0, mock=mock), duration=1.0)
    trace = guarded(scene_of(3, damping=4.0, mock=mock), FrozenDevice(after(20), channels=3, frozen=[1]), duration=1.0)
    assert no_force_at_the_end(trace, 1) < 200
    np.testing.assert_array_equal(trace.force_counts[:, [0, 2]], plain.force_counts[:, [0, 2]])
    assert trace.report.frozen.startswith("the position of hand1 has not")


@pytest.mark.thorough(keep=1)
@pytest.mark.parametrize("torque", [0.1, 1.0, 15.0])
def test_a_wheel_is_judged_by_angles(torque: float) -> None:
    scene = scene_of(
        stiffness=5.0 * max(torque, 1.0),
        damping=0.02,
        device=lenient(motion="rotary", mass=0.002, friction=0.005, force_limit=torque),
        mock={"quantum": 1e-4, "initial": {"velocity": 2.0}},
    )
    device = FrozenDevice(after(30))
    trace = guarded(scene, device, duration=0.8)
    most = MOST_M / SCALES["linear"].runaway * SCALES["rotary"].runaway
    assert np.abs(device.way(1e-4)[: no_force_at_the_end(trace) - 30]).max() < most


@pytest.mark.thorough(keep=2)
@pytest.mark.parametrize(
    ("device", "substeps"),
    [
        ({"correction": "predictor"}, 1),
        ({"correction": "predictor", "delay": 3.0}, 4),
        ({"correction": "poles"}, 1),
        ({"hold": "ramp"}, 1),
        ({"delay": 0.37}, 4),
        ({"sampling": "average"}, 1),
    ],
)
def test_whatever_makes_the_force(device: dict[str, Any], substeps: int) -> None:
    scene = scene_of(mock={"initial": {"velocity": 0.5}, "quantum": 1e-6}, device=lenient(**device))
    held = FrozenDevice(after(12))
    trace = guarded(scene.model_copy(update={"substeps": substeps}), held, duration=0.7)
    assert np.abs(held.way(1e-6)[: no_force_at_the_end(trace) - 12]).max() < 0.05


def test_at_a_declared_end_and_below_declared_dry_friction_standing_still_is_no_evidence() -> None:
    """A spring presses a fader against its stop; and dry friction holds a handle off its rest."""
    stop = {"stiffness": 50000.0, "damping": 20.0, "position": 0.01}
    at_stop = {"initial": {"position": 0.0101}, "hand": stop, "quantum": 1e-5}
    scene = scene_of(stiffness=50.0, damping=0.0, mock=at_stop)
    far = {"wall": scene.modules["wall"].model_copy(update={"position": 0.05})}
    pressed = scene.model_copy(update={"modules": {**scene.modules, **far}})
    assert guarded(pressed).report.sensor_tests > 0
    band = {"travel": (-0.05, 0.0102), "travel_margin": 0.005}
    bounded = pressed.model_copy(update={"device": pressed.device.model_copy(update=band)})
    assert guarded(bounded).report.sensor_tests == 0
    stuck = scene_of(mock={"coulomb": 1.0, "initial": {"position": 0.0009, "velocity": 0.0}})
    assert guarded(stuck).report.sensor_tests == 0
    undeclared = FrozenDevice(after(0))
    assert guarded(scene_of(mock={"initial": {"position": 0.0009}}), undeclared).report.frozen_ticks > 0


def test_lost_positions_are_bridged() -> None:
    """A still position is tested at the same sample whether it is read every sample or every fourth one."""
    begun = {}
    for step in (1, 4):
        loop = assembled(scene_of(damping=0.0), options=RunOptions(judges_energy=True))
        for n in range(0, 400, step):
            assert arrive(loop, frame(n, 2000), 1_000_000 * (n + 1)) == RECEIVED
            loop.record.state.unanswered = 0  # its force has left
            if loop.record.frozen_sensor.tests and step not in begun:
                begun[step] = n
        assert loop.record.frozen_sensor.frozen[0] == 1
        assert loop.record.io.force_counts[0] == 0
        assert int(loop.record.state.lost_frames) == (0 if step == 1 else 297)
    fall = np.sqrt(2.0 * (SCALES["linear"].jerk + 4e-6) * 0.2 / 2.0) * RATE  # 2 N on 0.2 kg
    assert begun[1] == pytest.approx(fall, abs=3)
    assert 0 <= begun[4] - begun[1] < 8


@pytest.mark.parametrize("refresh", [5, 10, 30])
def test_a_sensor_that_is_refreshed_too_rarely_ends_the_run(refresh: int) -> None:
    """A hand swings the handle on a soft spring."""
    scene = scene_of(stiffness=60.0, damping=0.1, mock={"initial": {"velocity": 0.15}}, device=lenient(friction=0.5))
    device = FrozenDevice(after(5), refresh=refresh)
    with pytest.raises(GuardError, match=r"the position of hand0 stands still and jumps.*refreshed") as caught:
        guarded(scene, device)
    trace = caught.value.trace
    assert (caught.value.exit_status, trace.report.ending) == (4, "position a staircase")
    assert trace.report.released
    assert np.abs(device.way(1e-9)).max() < 0.06


def test_knocks_are_no_staircase() -> None:
    """A handle that flies to and fro between stiff springs, on coarse counts."""
    mock = {"quantum": 1e-4, "initial": {"velocity": 1.0}, "hand": {"stiffness": 3000.0, "damping": 0.5}}
    assert guarded(scene_of(damping=1.5, mock=mock, device=lenient())).report.ending == "done"


def test_it_is_on_behind_a_port_and_in_a_run_that_judges_energy() -> None:
    """And not in virtual time otherwise: there is no hand."""
    assert assembled(scene_of()).record.frozen_sensor.rate == 0
    assert assembled(scene_of(), options=RunOptions(judges_energy=True)).record.frozen_sensor.rate != 0
    with served(scene_of(device={"clock": "device"})) as (scene, _), start(scene, duration=0.01) as session:
        assert session._loop.record.frozen_sensor.rate != 0


def test_while_it_runs_its_progress_reports_it() -> None:
    scene = scene_of(mock={"initial": {"position": 0.004}})
    with start(scene, duration=0.5, between=FrozenDevice(after(0)), judges_energy=True) as session:
        session.wait()
        progress = session.progress()
    assert progress.frozen.startswith(
        "the position of hand0 has not changed by one count for 500 ms although force acted"
    )
    assert (progress.sensor_tests, progress.frozen_ticks) == (1, session.trace.report.frozen_ticks)
