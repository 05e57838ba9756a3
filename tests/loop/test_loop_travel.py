"""Within its travel a device gets the scene's force; in a band outside that fades; beyond the band a run ends."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from loop_rig import arrive, assembled, frame, scene_of
from numpy.typing import NDArray

from hapsim.errors import DescriptionError, GuardError, UsageError
from hapsim.loop.endings import RECEIVED
from hapsim.loop.guards.travel import OUT_OF_TRAVEL
from hapsim.loop.ring import FADED, LIMITED
from hapsim.measuring.pushes import pushes
from hapsim.prediction.force_bounds import fade_stiffness, travel_error
from hapsim.recording.trace import Trace
from hapsim.running import Excitation, run
from hapsim.running.requirements import require_known_zero
from hapsim.scales import SCALES
from hapsim.scene import Scene

LIMIT, MARGIN = 0.003, 0.01
BAND: dict[str, Any] = {"travel": [-LIMIT, LIMIT], "travel_margin": MARGIN}


def flung(speed: float, position: float = 0.0, **mock: Any) -> dict[str, Any]:
    return {"initial": {"velocity": speed, "position": position}, **mock}


def ended(scene: Scene, match: str = "channel 0 is out of its travel", **options: Any) -> Trace:
    """Returns the trace of a run that leaves its travel."""
    with pytest.raises(GuardError, match=match) as caught:
        run(scene, duration=2.0, **options)
    assert caught.value.exit_status == 4
    trace = caught.value.trace
    assert (trace.report.ending, trace.report.released) == ("out of travel", True)
    return trace


def left(position: NDArray[np.float64], limit: float = LIMIT) -> NDArray[np.float64]:
    """Returns the share of the force that remains at each position of the device."""
    return np.clip(1.0 - (np.abs(position) - limit) / MARGIN, 0.0, 1.0)


def test_within_the_limits_nothing_changes() -> None:
    mock = {"initial": {"velocity": 0.15}, "noise": 1e-6}
    free = run(scene_of(2, mock=mock), duration=0.5)
    bounded = run(scene_of(2, mock=mock, device=BAND), duration=0.5)
    assert 0.5 * LIMIT < np.abs(free.position).max() < LIMIT
    np.testing.assert_array_equal(bounded.position_counts, free.position_counts)
    np.testing.assert_array_equal(bounded.force_counts, free.force_counts)
    np.testing.assert_array_equal(bounded.flags, free.flags)
    assert bounded.report.faded_ticks == 0


def test_outside_the_force_fades_by_the_way_and_each_channel_by_its_own() -> None:
    device = {"travel": [[-LIMIT, LIMIT], [-1.0, 1.0]], "travel_margin": MARGIN, "force_limit": 4.0}
    trace = run(scene_of(2, mock=flung(0.5), device=device), duration=0.5)
    share = left(trace.position) * [1.0, 0.0] + [0.0, 1.0]
    assert 0.1 < share[:, 0].min() < 0.6  # it went far into the band
    scale = trace.force_scale
    wanted = np.rint(np.rint(np.clip(trace.asked_force, -4.0, 4.0) / scale) * share)
    assert np.abs(wanted - trace.force_counts).max() <= 1
    outside = np.abs(trace.position[:, 0]) > LIMIT
    np.testing.assert_array_equal(trace.flags & FADED > 0, outside)
    assert trace.report.faded_ticks == outside.sum() > 50
    cut = np.any(np.abs(trace.asked_force) > 4.0, axis=1)
    np.testing.assert_array_equal(trace.flags & LIMITED > 0, cut)


def test_a_channel_that_no_hand_holds_has_its_own_limits() -> None:
    scene = scene_of(3, mock={"initial": {"position": [0.0, LIMIT + 0.5 * MARGIN, 0.0]}}, device=BAND)
    held = {name: one for name, one in scene.modules.items() if not name.endswith("1")}
    trace = run(scene.model_copy(update={"modules": held}), duration=0.01)
    assert trace.report.faded_ticks == trace.report.ticks == 10


@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_beyond_the_band_the_run_ends_with_the_position_the_limits_and_what_to_do(side: float) -> None:
    scene = scene_of(stiffness=10.0, mock=flung(side * 0.5), device=BAND)
    trace = ended(scene, rf"at {'-' if side < 0 else ''}0\.013\d* m, .*from -0\.003 to 0\.003 m.*0\.01 m outside")
    outside = np.abs(trace.position[:, 0]) - LIMIT
    assert np.all(outside[:-1] <= MARGIN)
    assert MARGIN < outside[-1] < MARGIN + 0.001
    assert trace.force_counts[-1, 0] == 0
    with pytest.raises(GuardError, match=r"wrong sign, a wrong device\.origin, a device that restarted"):
        run(scene, duration=2.0)


def test_noise_and_counts_are_no_way_out() -> None:
    """At rest a micrometre inside the band's end, where noise of a micrometre goes beyond it all the time."""
    still = {"initial": {"position": LIMIT + MARGIN - 1e-6}, "noise": 1e-6, "hand": {"stiffness": 1e5, "damping": 50.0}}
    still["hand"]["position"] = LIMIT + MARGIN - 1e-6  # type: ignore[index]
    trace = run(scene_of(stiffness=0.0, damping=0.0, mock=still, device=BAND), duration=0.5)
    assert (np.abs(trace.position[:, 0]) > LIMIT + MARGIN).sum() > 20
    coarse = {"initial": {"position": 0.0128}, "quantum": 5e-4}  # read as 13 mm, or as 12.5
    run(scene_of(stiffness=0.0, damping=0.0, mock=coarse, device=BAND), duration=0.1)


def test_a_device_at_its_own_stop_in_the_band_is_held_there_and_runs_on() -> None:
    """The scene pulls it outward with 2.5 N, the stop is a stiff spring 3 mm outside."""
    stop = {"stiffness": 50000.0, "damping": 20.0, "position": 2 * LIMIT}
    mock = {"initial": {"position": 2 * LIMIT}, "hand": stop}
    scene = scene_of(stiffness=50.0, mock=mock, device=BAND)
    far = {"wall": scene.modules["wall"].model_copy(update={"position": 0.05 + 2 * LIMIT})}
    trace = run(scene.model_copy(update={"modules": {**scene.modules, **far}}), duration=0.5)
    assert trace.report.faded_ticks == trace.report.ticks == 500
    at_stop = trace.position[-1, 0]
    assert at_stop == pytest.approx(2 * LIMIT, abs=1e-4)
    assert trace.force[-1, 0] == pytest.approx(50.0 * (0.056 - at_stop) * float(left(at_stop)), rel=1e-4)


def test_one_that_is_armed_beyond_the_band_comes_in_without_a_force() -> None:
    trace = run(scene_of(mock=flung(-0.4, LIMIT + 3 * MARGIN), device=BAND), duration=0.085)
    outside = trace.position[:, 0] - LIMIT
    assert outside[0] > 2.9 * MARGIN
    assert not trace.force_counts[outside > MARGIN].any()
    assert trace.position[-1, 0] < LIMIT  # and once it was within, the band is where it always is
    back = ended(scene_of(mock=flung(-1.5, LIMIT + 3 * MARGIN, hand={"force": 6.0}), device=BAND))
    assert MARGIN < back.position[-1, 0] - LIMIT < 1.2 * MARGIN
    resting = run(scene_of(mock=flung(0.0, LIMIT + 3 * MARGIN), device=BAND), duration=0.2)
    assert resting.report.faded_ticks == 200
    outward = ended(scene_of(mock=flung(0.4, LIMIT + 3 * MARGIN), device=BAND))
    assert 4 * MARGIN < outward.position[-1, 0] - LIMIT < 4.1 * MARGIN


def test_the_scene_counts_from_its_origin() -> None:
    """The mock stands 15 and 20 mm from where it powered up; the hands are on springs at the scene's 0."""
    mock = {"initial": {"velocity": [0.1, 0.0], "position": [0.015, 0.02]}}
    trace = run(scene_of(2, mock=mock, device={"origin": [0.01, "here"], "travel": [-0.1, 0.1]}), duration=0.2)
    np.testing.assert_allclose(trace.position[0], [0.005, 0.0], rtol=0, atol=1e-9)
    same = {"initial": {"velocity": [0.1, 0.0], "position": [0.005, 0.0]}}
    there = run(scene_of(2, mock=same), duration=0.2)
    assert np.abs(trace.position_counts - there.position_counts).max() <= 2  # the mock rounds at another place
    np.testing.assert_allclose(trace.force, there.force, rtol=0, atol=2e-4)  # B/T of a count: 2e-6


def test_the_limits_are_by_the_scenes_positions() -> None:
    away = {"initial": {"position": 0.5, "velocity": 0.5}}
    trace = ended(scene_of(stiffness=10.0, mock=away, device={**BAND, "origin": "here"}), r"at 0\.013\d* m")
    assert trace.position[0, 0] == 0.0
    trace = ended(scene_of(stiffness=10.0, mock=away, device={**BAND, "origin": 0.499}), r"at 0\.013\d* m")
    assert trace.position[0, 0] == pytest.approx(0.001, abs=1e-9)
    with pytest.raises(UsageError, match=r"device\.origin: found 3 m on channel 0; this device counts up to"):
        run(scene_of(device={"origin": 3.0}), duration=0.1)


@pytest.mark.usefixtures("leaps_allowed")
def test_after_lost_positions_the_newest_one_counts() -> None:
    scene = scene_of(stiffness=100.0, damping=0.0, device={**BAND, "clock": "device"})
    loop = assembled(scene)
    inside, far, beyond = 1000, 11000, 14000  # µm
    for number, counts, code in (
        (0, inside, RECEIVED),
        (1, inside, RECEIVED),
        (7, far, RECEIVED),
        (12, beyond, OUT_OF_TRAVEL),
    ):
        assert arrive(loop, frame(number, counts), 1_000_000 * (number + 1)) == code
        asked = -100.0 * counts * 1e-6
        sent = int(loop.record.io.force_counts[0])
        assert sent == round(round(asked * 1e3) * float(left(np.array(counts * 1e-6))))
    assert int(loop.record.travel.faded_ticks) == 2
    assert int(loop.state.lost_frames) == 5 + 4


def test_a_predictor_knows_the_force_that_faded() -> None:
    """The scene's spring and damper answer the state at the next sample, as it then is: the position that was read and
    the velocity with which the force that was sent makes it the one after."""
    trace = run(scene_of(mock=flung(0.6), device={**BAND, "correction": "predictor"}), duration=0.2)
    mass, friction, period = 0.2, 1.0, 1e-3
    of_speed = mass / friction * -np.expm1(-friction / mass * period)
    position, force = trace.position[:, 0], trace.force[:, 0]
    speed = (position[2:] - position[1:-1] - force[:-2] / friction * (period - of_speed)) / of_speed
    state, asked = -np.stack([position[1:-1], speed], axis=1)[2:], trace.asked_force[2:-2, 0]
    within = trace.flags[2:-2] & FADED == 0
    assert 30 < within.sum() < within.size - 50
    spring_and_damper, *_ = np.linalg.lstsq(state[within], asked[within], rcond=None)
    np.testing.assert_allclose(asked, state @ spring_and_damper, rtol=0, atol=1e-3)


def test_an_excitation_fades_too_and_is_never_taken_for_the_scenes() -> None:
    """A hand comes in against pushes outward, and no scene is there: it gives nothing, whatever of them leaves."""
    pushes = Excitation(channel=0, force=2.0, ticks=40, every=1000, start=0, first=True)
    device = {**BAND, "energy_limit": 1e-6}
    mock = flung(-0.2, LIMIT + 0.9 * MARGIN)
    trace = run(scene_of(stiffness=0.0, damping=0.0, mock=mock, device=device), duration=0.06, excitation=pushes)
    pushed = slice(0, 30)
    np.testing.assert_allclose(trace.force[pushed, 0], 2.0 * left(trace.position[pushed, 0]), rtol=0, atol=1e-6)
    assert trace.flags[:30].all()


@pytest.mark.parametrize(("share", "grows"), [(0.9, False), (1.1, True)])
def test_the_band_that_is_accepted_does_not_shake_a_hand(share: float, grows: bool) -> None:
    """Pulled outward by the force limit, held in the middle of the band by a light hand that pushes with half of it."""
    at_limit = fade_stiffness(scene_of(device=BAND), 0)
    force = share * at_limit * MARGIN
    hand = {"force": -0.5 * force, "damping": SCALES["linear"].grip_damping}
    mock = {"initial": {"position": LIMIT + 0.5 * MARGIN + 2e-6}, "hand": hand}
    scene = scene_of(stiffness=1e6, damping=0.0, mock=mock, device={**BAND, "force_limit": force})
    far = {"wall": scene.modules["wall"].model_copy(update={"position": 1.0})}
    assert (travel_error(scene) != "") is grows
    wide = scene.device.model_copy(update={"travel_margin": MARGIN})
    trace = unjudged(scene.model_copy(update={"device": wide, "modules": {**scene.modules, **far}}))
    swing = np.abs(trace.position[:, 0] - LIMIT - 0.5 * MARGIN)
    assert (swing[-100:].max() > swing[100:200].max()) == grows


def unjudged(scene: Scene) -> Trace:
    """A run that no prediction refuses."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("hapsim.running.requirements.travel_error", lambda _: "")
        return run(scene, duration=0.5)


def test_a_band_that_is_too_narrow_is_refused_before_anything_is_armed() -> None:
    scene = scene_of(device={"travel": [-0.05, 0.05], "travel_margin": 0.002})
    with pytest.raises(UsageError, match=r"of up to 10 N fades over 0\.002 m.* 5000 N/m .* at least 0\.00248 m"):
        run(scene, duration=0.1)
    assert not travel_error(scene_of(device={"travel": [-0.05, 0.05], "travel_margin": 0.00248}))
    assert not travel_error(scene_of(device={"travel": [-0.05, 0.05], "friction": 0.0}))
    two = scene_of(2, device={"travel": [[-0.05, 0.05], [0.0, 0.001]]})
    assert "over 0.0001 m on channel 1, " in travel_error(two)


@pytest.mark.parametrize(
    ("origin", "travel", "is_known"),
    [(0.01, True, False), (0.0, True, False), ("here", True, True), (None, True, True), (0.01, False, True)],
)
def test_a_restarted_device_has_lost_a_zero_that_the_scene_names(origin: Any, travel: bool, is_known: bool) -> None:
    scene = scene_of(device=({"origin": origin} if origin is not None else {}) | (BAND if travel else {}))
    if is_known:
        require_known_zero(scene, "port")
    else:
        with pytest.raises(DescriptionError, match=r"port: the device restarted: .* Not armed again"):
            require_known_zero(scene, "port")


def test_what_measures_pushes_less_where_the_travel_is_short() -> None:
    def swing(**device: Any) -> float:
        planned = pushes(scene_of(mock=flung(0.0), device=device), 0, 2.0, None)
        return planned.force * planned.ticks * 1e-3 / 0.2 * np.sqrt(0.2 / 1000.0)

    assert swing() == pytest.approx(0.1 * np.sqrt(0.2 / 1000.0), rel=0.05)
    assert swing(travel=[-0.1, 0.1]) == swing()
    assert swing(travel=[0.0, 0.002]) == pytest.approx(0.0005, rel=0.1)
