"""`hapsim identify` finds the mass, friction, spring and delay of known mocks."""

from __future__ import annotations

import os
import signal
from dataclasses import replace
from typing import Any

import device as plain
import numpy as np
import pytest
from identification import FORCE, NAMES, SECONDS, TRAVEL, Device, errors, random_device
from records import trace_of
from scipy.linalg import expm

import hapsim
from hapsim.errors import DeviceError, GuardError, HapsimError, UsageError
from hapsim.loop.endings import TIMED_OUT
from hapsim.measuring import identify_device as room
from hapsim.measuring.device_diagnosis import binned
from hapsim.measuring.device_motion import motion_of
from hapsim.running.run import run_to_end
from tests import thorough

# A few in the ordinary suite; HAPSIM_POINTS=50 takes fifty, for longer.
MANY = "HAPSIM_POINTS" in os.environ
DEVICES = thorough.points(2, 4)
ONE = Device(rate=1000.0, mass=0.2, friction=1.0, stiffness=0.0, delay=1.0, coulomb=0.0)


def identified(device: Device, wrong: float = 1.0, seconds: float = 2.0, **scene: str) -> hapsim.DeviceIdentification:
    return hapsim.identify_device(device.scene(wrong, **scene), force=FORCE, travel=TRAVEL, duration=seconds)


def assert_found(device: Device, found: hapsim.DeviceIdentification) -> None:
    """Every value within four of the uncertainties stated, and these are small."""
    _, scaled = errors(device, found)
    assert np.max(np.abs(scaled)) < 4.0
    assert found.mass.uncertainty < 1e-3 * device.mass
    assert found.delay.uncertainty < 0.01
    assert found.misfit == ""


def test_random_devices_are_found_as_well_as_the_uncertainties_state(figures: Any) -> None:
    all_off, all_scaled = [], []
    for seed in range(DEVICES):
        device = random_device(seed)
        found = identified(device, seconds=SECONDS if MANY else 3.0)
        off, scaled = errors(device, found)
        mass, friction, _, delay, _ = np.abs(off)
        assert mass < 1e-3 * device.mass
        assert friction < max(1e-3 * device.friction, 1e-3)  # of none a millinewton at 1 m/s
        assert delay < 0.01
        assert found.hand is None
        all_off.append(off)
        all_scaled.append(scaled)
    sizes = np.abs(all_scaled)
    within = [float(np.mean(sizes < limit)) for limit in (1.0, 1.96)]
    off = ", ".join(f"{name} {value:.1e}" for name, value in zip(NAMES, np.max(np.abs(all_off), axis=0), strict=True))
    figures.note(
        f"{DEVICES} devices identified, off at most by {off}; {within[0]:.0%} within the stated uncertainty, "
        f"{within[1]:.0%} within 1.96, root mean square {np.sqrt(np.mean(sizes**2)):.2f}, worst {np.max(sizes):.2f}"
    )
    # Within three standard deviations of the binomial distribution, were each value an independent draw.
    for share, found_share in zip((0.6827, 0.95), within, strict=True):
        assert abs(found_share - share) < 3.0 * np.sqrt(share * (1.0 - share) / sizes.size)
    assert np.max(sizes) < 4.5
    assert 0.6 < np.sqrt(np.mean(sizes**2)) < 1.5  # nor are they stated larger than they are


@pytest.mark.parametrize("wrong", [3.0, 1.0 / 3.0])
def test_mass_friction_and_delay_may_be_declared_wrong_by_a_factor_of_three(wrong: float) -> None:
    for seed in range(1, 51) if MANY else [1 if wrong > 1.0 else 2]:
        device = random_device(seed)
        found = identified(device, wrong)
        assert_found(device, found)
        assert found.peak_m < TRAVEL


@pytest.mark.parametrize(
    ("device", "kind"),
    [
        (replace(ONE, delay=1.37, stiffness=150.0), {"sampling": "average"}),
        (replace(ONE, delay=1.37, stiffness=150.0), {"hold": "impulse", "sampling": "average"}),
        (replace(ONE, delay=0.0, friction=0.0), {}),
    ],
    ids=["zoh, average", "impulse, average", "no delay, no friction"],
)
def test_a_device_is_found_whatever_its_hold_and_sampling(device: Device, kind: dict[str, str]) -> None:
    assert_found(device, identified(device, seconds=1.0, **kind))


def test_a_wire_on_which_every_force_is_late_is_a_delay_of_one_sample_more() -> None:
    """At 150 000 baud both frames take a sample period and a half."""
    found = hapsim.identify_device(mocked(baud=150_000), duration=1.0)
    assert found.traces[0].report.deadline_misses > 0.9 * found.traces[0].report.ticks
    assert found.delay.value == pytest.approx(2.0, abs=0.01)
    assert found.misfit == ""


def test_the_device_stays_within_force_and_travel() -> None:
    found = hapsim.identify_device(replace(ONE, coulomb=0.3).scene(), force=1.0, travel=0.002, duration=1.0)
    assert found.peak_m < 0.002
    assert max(float(np.max(np.abs(trace.force))) for trace in found.traces) <= 1.0
    assert len({(drive.stiffness, drive.damping) for drive in found.drives}) == 3
    assert found.bounds.force == 1.0


def mocked(**mock: Any) -> hapsim.Scene:
    """ONE with another mock."""
    scene = ONE.scene()
    return scene.model_copy(update={"mock": scene.mock.model_copy(update=mock)})  # type: ignore[union-attr]


@pytest.mark.parametrize(("noise", "quantum", "seed"), [(1e-5, 1e-9, 2), (0.0, 2.4e-5, 0)])
def test_noise_and_counts_are_uncertainty_and_the_device_stays_within_its_travel(
    noise: float, quantum: float, seed: int
) -> None:
    found = hapsim.identify_device(mocked(noise=noise, quantum=quantum, seed=seed), duration=2.0)
    _, scaled = errors(ONE, found)
    assert np.max(np.abs(scaled)) < 4.0
    assert found.mass.uncertainty < 0.02 * ONE.mass
    assert found.peak_m < 0.005
    assert found.misfit == ""
    assert found.noise_m == pytest.approx(noise, rel=0.2)


def test_the_gentlest_push_behind_a_port_is_clear_of_the_force_that_a_count_makes() -> None:
    """Else the damper shakes the device at the limit of that push, and the port's guard ends it."""
    scene, count_m = ONE.scene(), 1e-5
    scene = scene.model_copy(update={"device": scene.device.model_copy(update={"port": "/dev/ttyACM0"})})

    class RunError(Exception):
        pass

    def run_scene(pushed: hapsim.Scene, **_: Any) -> Any:
        raise RunError(pushed)

    pusher = room.Pusher(scene, 0, room.bounds_of(scene, 0, force=0.5), run_scene)
    pusher.count_m = count_m
    with pytest.raises(RunError) as caught:
        pusher.grow()
    pushed = caught.value.args[0]
    assert pushed.device.force_limit > 2.0 * pushed.modules["spring"].damping * scene.rate * count_m


def test_noise_that_hides_the_motion_is_named_with_the_travel_that_would_do() -> None:
    scene = mocked(noise=1e-5)
    with pytest.raises(UsageError, match=r"within 0\.1 mm .* noise of [\d.]+ µm\. .* --travel ([\d.]+)") as caught:
        hapsim.identify_device(scene, travel=1e-4, duration=1.0)
    advice = float(str(caught.value).split("--travel ")[1].split(" ")[0])
    assert 1.5e-4 <= advice <= 1e-3


class OnWire:
    """The second device, of tests/probe, in virtual time: `body` is what its motor moves. For `between`."""

    def __init__(self, body: Any) -> None:
        self._out, self._seconds = b"", 0.0
        self._device = plain.Device(self._put, lambda: self._seconds, {"rate": 1000.0, "pacings": 7})
        self._device.bodies = [body]

    def _put(self, data: bytes) -> int:
        self._out += data
        return len(data)

    def receive(self, buffer: np.ndarray, _timeout_ns: int) -> int:
        taken, self._out = self._out[: buffer.size], self._out[buffer.size :]
        buffer[: len(taken)] = np.frombuffer(taken, np.uint8)
        return len(taken) or TIMED_OUT

    def send(self, frame: bytes) -> int:
        if self._device.state == plain.ARMED:
            self._seconds += self._device.period
        self._device.take(bytes(frame))
        return 0


class Body:
    """0.2 kg and 1 N·s/m; with a hand, (kg, N/m, N·s/m), on it; `sign`: of its motor; `own`: N at s, that acts too."""

    def __init__(self, hand: tuple[float, ...] = (), sign: float = 1.0, own: Any = None) -> None:
        matrix = np.zeros((5, 5))
        matrix[0, 1] = matrix[2, 3] = 1.0
        matrix[1, 1], matrix[1, 4] = -1.0 / 0.2, 1.0 / 0.2
        if hand:
            mass, stiffness, damping = hand
            pull = np.array([stiffness, damping, -stiffness, -damping])
            matrix[1, :4] -= pull / 0.2
            matrix[3, :4] += pull / mass
        self._matrix, self._state, self._seconds = matrix, np.zeros(5), 0.0
        self._step, self._sign, self._own = expm(matrix * 1e-3), sign, own or (lambda _: 0.0)
        self.largest = 0.0

    def move(self, force: float, seconds: float) -> None:
        if seconds > 0.0:
            assert seconds == pytest.approx(1e-3)
            self._seconds += seconds
            self._state[4] = self._sign * force + self._own(self._seconds)
            self._state = self._step @ self._state
            self.largest = max(self.largest, abs(self.x))

    @property
    def x(self) -> float:
        return float(self._state[0])

    @property
    def v(self) -> float:
        return float(self._state[1])


def identified_on_wire(**body: Any) -> tuple[Any, float]:
    """(what is found of a device in plain Python, or the error; how far it moved, m), each run from rest."""
    bodies = []

    def run(scene: hapsim.Scene, **options: Any) -> hapsim.Trace:
        bodies.append(Body(**body))
        return run_to_end(scene, between=lambda _: OnWire(bodies[-1]), **options)

    try:
        found: Any = hapsim.identify_device(ONE.scene(), duration=2.0, run=run)
    except HapsimError as error:
        found = error
    return found, max(one.largest for one in bodies)


@pytest.mark.thorough
def test_a_hand_that_is_a_second_mass_is_found_next_to_the_handle() -> None:
    hand = (1.0, 2000.0, 10.0)
    found, largest = identified_on_wire(hand=hand)
    assert largest < 0.005
    assert found.mass.value == pytest.approx(0.2, rel=1e-4)
    assert found.delay.value == pytest.approx(1.0, abs=1e-3)
    values = (found.hand.mass.value, found.hand.stiffness.value, found.hand.damping.value)
    assert values == pytest.approx(hand, rel=1e-3)


def test_an_inverted_motor_is_named_before_it_ran_far() -> None:
    found, largest = identified_on_wire(sign=-1.0)
    assert isinstance(found, GuardError)
    assert "motor and position disagree in sign" in str(found)
    assert largest < 0.005


def test_a_force_of_another_is_named_and_not_the_sign() -> None:
    found, _ = identified_on_wire(own=lambda t: 0.3 * np.sin(2.0 * np.pi * 2.3 * t) * min(t, 1.0))
    assert isinstance(found, DeviceError)
    assert "they explain" in str(found)
    assert "sign" not in str(found)


@pytest.mark.thorough(keep=1)
@pytest.mark.parametrize(
    ("coulomb", "bounds", "kind", "sentence"),
    [
        # It breaks away from a dry friction that is large for so small a travel, and no hand is blamed for it.
        (
            1.5,
            (5.0, 2e-4),
            GuardError,
            r"beyond the allowed 0\.2 mm: the measurement ended\. .* broken away from dry friction",
        ),
        (0.5, (1.0, 2e-4), UsageError, r"the device by 0\.19\d* mm, but in jerks .*: dry friction holds it"),
        (3.0, (2.0, None), UsageError, "stuck by dry friction"),
    ],
    ids=["breaks away", "moves in jerks", "is stuck"],
)
def test_dry_friction_that_spoils_the_motion_is_named(
    coulomb: float, bounds: tuple[float, float | None], kind: type[HapsimError], sentence: str
) -> None:
    with pytest.raises(kind, match=sentence):
        hapsim.identify_device(replace(ONE, coulomb=coulomb).scene(), force=bounds[0], travel=bounds[1], duration=1.0)


@pytest.mark.thorough(keep=2)
@pytest.mark.parametrize(
    "device",
    [
        replace(ONE, mass=0.001, friction=0.0, stiffness=100.0, delay=0.0),
        replace(ONE, mass=0.02, friction=0.1, stiffness=900.0, quantum=1e-7),
        replace(ONE, mass=0.005, friction=0.05, stiffness=3000.0, delay=1.5, noise=1e-6),
    ],
    ids=["50 Hz", "34 Hz, damped", "123 Hz, noisy"],
)
def test_a_device_that_swings_fast_on_a_spring_of_its_own_is_found(device: Device) -> None:
    """It turns several times during a push, so that no motion keeps its direction for long. No hand is invented."""
    found = identified(device, wrong=1.3)
    _, scaled = errors(device, found)
    assert np.max(np.abs(scaled)) < 4.5
    assert found.stiffness.uncertainty < 0.01 * device.stiffness
    assert found.hand is None


def test_a_device_that_moves_by_itself_is_not_pushed() -> None:
    scene = mocked(stiffness=2000.0, initial=hapsim.scene.Initial(position=0.01))
    with pytest.raises(GuardError, match=r"without any force the device moved by .* it was not pushed"):
        hapsim.identify_device(scene)
    wired = scene.model_copy(update={"device": scene.device.model_copy(update={"port": "/dev/ttyACM9"})})
    with pytest.raises(GuardError, match="The boards with a simulated mass give it a speed at each arming"):
        hapsim.identify_device(wired, transport="loopback")


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        ({"force": 11.0}, "force: found 11 N, expected above 0 N, and at most the force_limit, 10 N"),
        ({"force": float("nan")}, "force: found nan"),
        ({"travel": 0.0}, "travel: found 0, expected a finite number of metres above 0"),
        ({"duration": -1.0}, "duration: found -1"),
        ({"channel": 3}, "channel 3: the scene has nothing there; its device points are on: 0"),
    ],
)
def test_what_cannot_be_is_refused_before_anything_runs(options: dict[str, Any], sentence: str) -> None:
    with pytest.raises(UsageError) as caught:
        hapsim.identify_device(ONE.scene(), **options)
    assert sentence in str(caught.value)


def test_an_interrupt_ends_the_recording_and_what_there_is_is_reported(monkeypatch: pytest.MonkeyPatch) -> None:
    all_swings = room.swings_of

    def run(scene: hapsim.Scene, **options: Any) -> hapsim.Trace:
        """The recording, not the short runs before it, is interrupted once it has some samples."""
        if options["duration"] > 1000.0:
            options["on_progress"] = lambda now: now.ticks > 5000 and signal.raise_signal(signal.SIGINT)
        return run_to_end(scene, **options)

    monkeypatch.setattr(room, "swings_of", lambda *record: all_swings(*record)[:100])  # enough, of a long record
    device = replace(ONE, coulomb=0.1)
    found = hapsim.identify_device(device.scene(), duration=6000.0, transport="loopback", stop_on_signals=True, run=run)
    assert found.stopped
    assert len(found.drives) == 1
    assert found.mass.value == pytest.approx(0.2, rel=1e-3)


def test_a_correction_that_takes_the_declared_mass_for_true_is_left_out() -> None:
    scene = replace(ONE, delay=1.6).scene(wrong=3.0)
    corrected = scene.model_copy(update={"device": scene.device.model_copy(update={"correction": "predictor"})})
    plain, found = (hapsim.identify_device(one, duration=1.0) for one in (scene, corrected))
    assert found == plain


@pytest.mark.thorough(keep=1)
@pytest.mark.parametrize(
    ("backlash", "expected"), [(0.0, "a belt between motor and handle"), (5e-5, "motor and handle have play")]
)
def test_a_belt_and_its_play_are_named_where_one_mass_does_not_fit(backlash: float, expected: str) -> None:
    belt = {"stiffness": 3.3e4, "damping": 1.4, "motor_mass": 0.05, "sensor": "motor", "backlash": backlash}
    scene = ONE.scene()
    assert scene.mock is not None
    mock = scene.mock.model_copy(
        update={"transmission": type(scene.mock).model_validate({"transmission": belt}).transmission}
    )
    found = hapsim.identify_device(scene.model_copy(update={"mock": mock}), force=FORCE, travel=TRAVEL, duration=1.5)
    assert expected in found.misfit
    assert "--transmission" in found.misfit


LACKING: dict[str, Any] = {
    "depends on the position": lambda x, _v, _t: 0.05 * np.sin(2.0 * np.pi * x / 2e-3),
    "depends on the velocity": lambda _x, v, _t: 0.1 * np.sign(v) * np.exp(-((v / 0.02) ** 2)),
    "depends on neither position, velocity nor reversals": lambda _x, _v, t: 0.02 * np.sin(2.0 * np.pi * 3.3 * t),
}


@pytest.mark.thorough(keep=1)
@pytest.mark.parametrize("sentence", LACKING)
def test_a_force_that_the_model_lacks_is_reported_with_what_it_depends_on(
    sentence: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A mock has none: what is recorded as sent is more, by that force, than what acted."""
    as_recorded = room.motion_of

    def motion_of(trace: hapsim.Trace, channel: int, home: float, most_delay: float) -> Any:
        motion = as_recorded(trace, channel, home, most_delay)
        position, time = trace.position[:, channel], np.arange(trace.sample.size) / trace.rate
        more = LACKING[sentence](position, np.gradient(position) * trace.rate, time)
        return replace(motion, force=motion.force + more)

    monkeypatch.setattr(room, "motion_of", motion_of)
    found = hapsim.identify_device(ONE.scene(), duration=1.5)
    assert sentence in found.misfit
    if "position" in sentence and "neither" not in sentence:  # and the residual has its shape, with the other sign
        lacking = found.force_residual
        _, at, means = binned(lacking.position, lacking.force)
        assert np.corrcoef(means, -np.sin(2.0 * np.pi * at / 2e-3))[0, 1] > 0.9


def test_after_a_gap_the_forces_are_known_a_delay_later() -> None:
    whole = trace_of(np.zeros(60), np.zeros(60))
    gap = replace(whole, sample=np.append(np.arange(20), np.arange(25, 65)))
    assert motion_of(gap, 0, 0.0, 1.5).known == ((0, 20), (24, 60))
