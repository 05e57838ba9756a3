"""The measured driving-point impedance: beside the prediction at every frequency, how certain, and when it is none."""

from __future__ import annotations

import itertools
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scipy.stats
from records import trace_of
from rich.console import Console
from scenes import one_spring

from hapsim.cli.measure_matrices import measured_width, show_impedance
from hapsim.errors import UsageError
from hapsim.holds import HOLDS
from hapsim.loop.ring import LATE_FORCE, UNSENT
from hapsim.measuring import periodic_excitation
from hapsim.measuring.converters import Converters
from hapsim.measuring.measure_impedance import MeasuredImpedance, StoppedError, measure_impedance, walls_in_place
from hapsim.measuring.periodic_excitation import Periods, _quantile, impedance_of, lines_for, multisine, periods_of
from hapsim.prediction import predict
from hapsim.prediction.predict_impedance import mean_width, predict_impedance, z_width_of
from hapsim.recording.trace import Trace
from hapsim.running import run
from hapsim.scene import Scene, Span, load_scene, parse_scene
from hapsim.theory.interface import delay_and_hold

CONFIGS = Path(__file__).parents[2] / "configs"
SHIPPED = ("first_touch", "paper_6_2_one_sample", "sensed_velocity", "sprung_device", "held_string", "two_hands")
KINDS = ("device", "rendered", "closed_loop")


def shipped(name: str) -> Scene:
    """Loads a shipped scene, in virtual time."""
    scene = load_scene(CONFIGS / f"{name}.yaml")
    return scene.model_copy(update={"device": scene.device.model_copy(update={"clock": "lockstep"})})


@cache
def measured(name: str) -> MeasuredImpedance:
    return measure_impedance(shipped(name))


def off_by(found: MeasuredImpedance, scene: Scene, kind: str) -> np.ndarray:
    """(n, C, C): measured and predicted, apart by so many of the stated uncertainties."""
    predicted = predict_impedance(scene, found.frequency)
    circles = getattr(found, kind)
    apart = np.abs(circles.value - getattr(predicted, kind))
    with np.errstate(divide="ignore"):  # hands that are not tied: 0, exactly
        return np.divide(apart, circles.uncertainty, out=np.zeros_like(apart), where=apart > 0.0)


@pytest.mark.parametrize("name", SHIPPED)
def test_of_shipped_scenes_measured_and_predicted_agree_within_the_uncertainty_at_every_frequency(
    name: str, figures: Any
) -> None:
    found = measured(name)
    assert found.frequency[0] == 2.0
    assert found.frequency[-1] > 0.88 * 0.5 * shipped(name).rate
    for kind in KINDS:
        off = off_by(found, shipped(name), kind)
        assert off.max() <= 1.0
        figures.most(f"impedance {kind}, predicted and measured apart, of the stated uncertainty", off.max())
        circles = getattr(found, kind)
        own = np.arange(len(found.channels))
        certain = circles.uncertainty[:, own, own] / np.abs(circles.value[:, own, own])
        assert np.median(certain) < 1e-3  # and it is no wide circle that holds them
        assert certain.max() < 1e-2


def test_the_impedance_of_a_predictor_ends_at_its_steady_stiffness_for_whichever_mass_it_was_made() -> None:
    """A predictor for an uncertain mass is made for one mass of the span, which is not the middle."""
    scene = one_spring(2000.0, 15.0, friction=1.0)
    spanned = {"mass": Span(least=0.15, most=0.3), "correction": "predictor"}
    scene = scene.model_copy(update={"device": scene.device.model_copy(update=spanned)})
    prediction = predict(scene, with_margins=False)
    (port,), (desired,) = prediction.rendering.ports, prediction.desired
    assert abs(port.made_for / port.declared.mass - 1.0) > 0.1
    slow = np.array([1e-3])  # Hz
    stiffness = 2j * np.pi * slow * predict_impedance(scene, slow).rendered[:, 0, 0]
    assert abs(stiffness[0]) == pytest.approx(desired.steady_stiffness, rel=1e-6)


def test_the_sentences_have_the_numbers_of_what_was_measured() -> None:
    found, predicted = measured("two_hands"), predict_impedance(shipped("two_hands"), measured("two_hands").frequency)
    out = Console(width=100_000)
    with out.capture() as capture:
        show_impedance(out, predicted, found, [0, 1])
    told = capture.get()
    for i, channel in enumerate(found.channels):
        trace = found.traces[i]
        force = np.max(np.abs(trace.force[:, channel] - trace.asked_force[:, channel]))
        moved = 1e3 * np.ptp(trace.position[-round(found.period_s * trace.rate) :, channel])
        assert (
            f"Channel {channel} was excited with up to {force:.3g} N, which moved it by {moved:.3g} mm; "
            f"{found.periods[i] + 1} periods of 0.5 s count."
        ) in told
    for kind, words in zip(KINDS, ("device's own", "rendered", "closed-loop"), strict=True):
        apart = off_by(found, shipped("two_hands"), kind).max()
        assert (
            f"The {words} impedance: prediction and measurement agree within the uncertainty at all "
            f"{found.frequency.size} frequencies, at most {apart:.2g} of it apart."
        ) in told
    value, radius = found.rendered.value[0, 1, 1], found.rendered.uncertainty[0, 1, 1]
    assert f"{abs(value):.5g} ∠ {np.degrees(np.angle(value)):.1f}° │ {radius:.1g}" in " ".join(told.split())
    late = replace(predicted, device=1.5 * predicted.device)
    with out.capture() as capture:
        show_impedance(out, late, found, [0])
    assert "The device's own impedance: prediction and measurement do not agree: " in capture.get()


def test_what_one_hand_feels_of_the_other_is_measured_as_a_matrix() -> None:
    found = measured("two_hands")
    assert found.channels == (0, 1)
    rendered = found.rendered.value
    np.testing.assert_allclose(rendered[:, 0, 1], rendered[:, 1, 0], rtol=1e-3)
    assert np.abs(rendered[:5, 0, 1]).min() > 5.0  # N·s/m
    assert np.all(np.abs(found.device.value[:, 0, 1]) <= found.device.uncertainty[:, 0, 1])


@pytest.mark.parametrize(("name", "at", "peaks"), [("held_string", (0, 0), 2), ("two_hands", (0, 1), 1)])
def test_the_peaks_stand_where_the_scenes_that_ship_name_them(name: str, at: tuple[int, int], peaks: int) -> None:
    f = np.arange(20.0, 90.0, 0.1)
    size = np.abs(predict_impedance(shipped(name), f).rendered[:, *at])
    found = f[1:-1][(size[1:-1] > size[:-2]) & (size[1:-1] > size[2:])]
    assert found.size == peaks
    comment = (CONFIGS / f"{name}.yaml").read_text()
    assert all(f"{peak:.1f} Hz" in comment for peak in found)


def test_an_excitation_keeps_to_a_quarter_of_the_force_limit_and_about_to_its_travel() -> None:
    scene = one_spring(2000.0, 5.0, friction=1.0, force_limit=4.0)
    for travel in (1e-3, 1e-4):
        found = measure_impedance(scene, travel=travel)
        (peak,), (moved,) = found.peak_force, found.travel
        added = found.traces[0].force - found.traces[0].asked_force
        assert np.abs(added).max() == pytest.approx(peak, rel=1e-6)
        assert peak <= 1.0 + 1e-9
        assert moved < 1.5 * travel
    assert moved > 0.5 * travel  # the smaller one is what bounds it, not the force
    assert peak < 0.9


@pytest.mark.parametrize("seed", range(4))
def test_noise_of_the_position_is_within_the_uncertainty_and_no_small_part_of_it(seed: int) -> None:
    quiet = one_spring(2000.0, 5.0, friction=1.0)
    scene = quiet.model_copy(update={"mock": quiet.mock.model_copy(update={"noise": 1e-6, "seed": seed})})
    found = measure_impedance(scene)
    for kind in ("device", "closed_loop"):
        off = off_by(found, scene, kind)
        assert off.max() <= 1.0
        assert 0.08 < np.median(off) < 0.5


@pytest.mark.parametrize(("damper", "kind"), [("backward", "device"), ("sensed", "rendered")])
def test_counts_are_within_the_uncertainty_even_where_every_period_is_rounded_alike(damper: str, kind: str) -> None:
    """Noise-free periods repeat to the last count: their scatter is zero, and all contain the rounding. The rounding of
    a sensed velocity is in no trace. It shows in the scene's force at frequencies that nothing excites."""
    scene = one_spring(2000.0, 15.0, friction=5.0, quantum=1e-7, velocity=0.0, damper=damper)
    found = measure_impedance(scene)
    off = off_by(found, scene, kind)
    assert off.max() <= 1.0
    if damper == "backward":
        last = found.traces[0].position_counts[-500:, 0]
        assert np.array_equal(last, found.traces[0].position_counts[-1000:-500, 0])
        assert np.median(off) > 0.03


def test_each_element_of_a_matrix_has_an_uncertainty_of_its_own() -> None:
    """Two channels, of which one is excited ten times as much, and forces with noise in one experiment alone."""
    rng = np.random.default_rng(5)
    count, frequency = 60, np.linspace(1.0, 100.0, 300)
    ratio = np.array([[3.0, 0.5 + 1j], [2.0, 1.0 - 2j]])
    moved = np.array([[10.0, 0.3], [1.0, 1.0]])  # [channel, experiment]
    none = np.zeros(2)
    experiments = []
    for d, noise in enumerate((0.0, 1.0)):
        position = np.broadcast_to(moved[:, d], (count, 300, 2)).astype(complex)
        force = position @ ratio.T
        force = force + noise * (rng.normal(size=force.shape) + 1j * rng.normal(size=force.shape))
        experiments.append(Periods(position, 0.0 * force, force, none, none + 1e-30, True, 0, 0))
    found = impedance_of(experiments, frequency, 1000.0, 0.0, Converters("impulse", "ideal"))
    true = ratio / (2j * np.pi * frequency[:, None, None])
    off = np.abs(found.device.value - true) / found.device.uncertainty
    typical = np.median(off, axis=0)
    assert off.max() <= 1.0
    assert np.all((typical > 0.1) & (typical < 0.3))


def test_a_device_that_is_later_than_it_declares_does_not_look_like_its_mass() -> None:
    scene = shipped("first_touch")
    late = scene.model_copy(update={"mock": scene.mock.model_copy(update={"delay": 2.0})})
    found = measure_impedance(late)
    assert off_by(found, scene, "rendered").max() <= 1.0  # that is the scene's, whatever the device
    off = off_by(found, scene, "device")[:, 0, 0]
    assert np.all(off[found.frequency > 20.0] > 10.0)


def test_an_instant_of_the_hold_and_the_delay_are_those_of_the_theory() -> None:
    f = np.geomspace(1.0, 480.0, 30)
    theta = 2.0 * np.pi * f / 1000.0
    for hold, sampling, delay in itertools.product(HOLDS, ("ideal", "average"), (0.0, 0.4, 1.0, 2.0)):
        found = Converters(hold, sampling).response(f, 1000.0, delay)
        np.testing.assert_allclose(found, delay_and_hold(theta, delay, hold, sampling), rtol=1e-12)


class TestRecords:
    """A sound record is spoilt with missing, late or unsent rows."""

    lines = lines_for(1000.0)

    def spectra(self, **changed: Any) -> Any:
        trace = replace(measured("first_touch").traces[0], **changed)
        return periods_of(trace, self.lines, Converters("zoh", "ideal"), senses=False)

    def test_a_period_with_a_lost_position_is_left_out_and_counted(self) -> None:
        trace = measured("first_touch").traces[0]
        kept = np.delete(np.arange(trace.sample.size), 1234)
        names = ("sample", "time_ns", "flags", "position_counts", "force_counts", "asked_force")
        whole, torn = self.spectra(), self.spectra(**{name: getattr(trace, name)[kept] for name in names})
        assert torn.position.shape[0] == whole.position.shape[0] - 2  # it is in two pairs
        assert (whole.lost, torn.lost) == (0, 1)
        # Positions are counted from their mean over the record, which no other frequency sees.
        np.testing.assert_allclose(torn.position, np.delete(whole.position, [1, 2], axis=0), rtol=1e-9)

    @pytest.mark.parametrize(("flag", "shown_at"), [(LATE_FORCE, 1), (UNSENT, 0)])
    def test_in_place_of_a_force_that_came_too_late_the_one_before_acted(self, flag: int, shown_at: int) -> None:
        trace = measured("first_touch").traces[0]
        flags, held = trace.flags.copy(), trace.force_counts.copy()
        flags[1234 + shown_at] |= flag
        held[1234] = held[1233]
        late, expected = self.spectra(flags=flags), self.spectra(force_counts=held)
        np.testing.assert_array_equal(late.force, expected.force)
        assert not np.array_equal(late.force, self.spectra().force)


def test_a_multisine_has_its_amplitudes_and_nothing_between_them() -> None:
    lines = lines_for(1000.0)
    amplitude = np.linspace(0.1, 0.2, lines.bins.size)
    wave = multisine(lines, amplitude, 100.0)
    spectrum = np.abs(np.fft.rfft(wave)) * 2.0 / lines.samples
    np.testing.assert_allclose(spectrum[lines.bins], amplitude, rtol=1e-9)
    assert np.delete(spectrum, lines.bins).max() < 1e-12
    assert np.abs(wave).max() < 3.0 * np.sqrt(np.mean(wave**2))
    assert np.abs(multisine(lines, amplitude, 0.3)).max() == pytest.approx(0.3)


def test_the_z_width_is_measured_where_the_stiffest_passive_wall_stands_in_the_scene_s_place() -> None:
    scene = shipped("two_hands")
    alone = measured("two_hands")
    widths = [z_width_of(scene, channel, alone.frequency)["passive"] for channel in alone.channels]
    walls = walls_in_place(scene, {c: tuple(w.wall) for c, w in zip(alone.channels, widths, strict=True)})
    with_walls = measure_impedance(walls, duration=7.0)
    assert off_by(with_walls, walls, "rendered").max() <= 1.0
    for i, width in enumerate(widths):
        found = measured_width(alone, i, with_walls)
        assert np.all(np.abs(found.width_db - width.width_db) <= found.uncertainty_db)
        assert np.median(found.uncertainty_db) < 0.01
        assert width.width_db[0] > 25.0  # dB, at 2 Hz
        assert mean_width(width.frequency, width.width_db) == pytest.approx(4.5, abs=0.3)


class TestSentences:
    @pytest.mark.parametrize(
        ("scene", "words"),
        [
            (
                {"stiffness": 2000.0, "damping": 5.0, "quantum": 3e-4},
                r"channel 0: an excitation of up to 2\.29 N moved it by \d+ counts of ",
            ),
            (
                {"stiffness": 0.0, "damping": 0.0, "mass": 1e6, "quantum": 1e-3},
                r"has not changed by one count for .* while force acts \(2\.5 N at most\): sensor or cable\?",
            ),
        ],
        ids=["few counts", "no motion"],
    )
    def test_a_motion_of_few_counts_or_none(self, scene: Any, words: str) -> None:
        with pytest.raises(UsageError, match=words):
            measure_impedance(one_spring(**scene, friction=1.0, velocity=0.0, force_limit=10.0))

    def test_a_run_that_was_stopped(self) -> None:
        trace = measured("first_touch").traces[0]

        def stopped(*_: Any, **__: Any) -> Trace:
            return replace(trace, report=replace(trace.report, ending="stopped"))

        with pytest.raises(StoppedError, match="stopped before every channel was excited") as caught:
            measure_impedance(shipped("first_touch"), run=stopped)
        assert caught.value.exit_status == 130

    def test_what_was_recorded_when_it_was_stopped_is_kept(self) -> None:
        whole, runs = measured("first_touch"), []

        def stopped_in_the_second_run(scene: Scene, *, duration: float, **options: Any) -> Trace:
            runs.append(duration)
            if len(runs) == 1:
                return run(scene, duration=duration, **options)
            trace = run(scene, duration=0.7 * duration, **options)
            return replace(trace, report=replace(trace.report, ending="stopped"))

        found = measure_impedance(shipped("first_touch"), run=stopped_in_the_second_run)
        assert found.stopped
        assert found.periods[0] < whole.periods[0]
        off = np.abs(found.closed_loop.value - whole.closed_loop.value)
        assert np.all(off <= found.closed_loop.uncertainty + whole.closed_loop.uncertainty)

    @pytest.mark.parametrize(
        ("options", "words"),
        [
            ({"duration": 1.0}, r"duration: found 1 s, expected at least 3 s \(6 periods of the excitation\)"),
            ({"duration": float("nan")}, "duration: found nan, expected a finite number of seconds above 0"),
            ({"travel": -1.0}, r"travel: found -1, expected a finite number of metres above 0"),
        ],
    )
    def test_numbers_that_cannot_be(self, options: dict[str, float], words: str) -> None:
        with pytest.raises(UsageError, match=words):
            measure_impedance(shipped("first_touch"), **options)


LINES = lines_for(1000.0)
CONVERTERS = Converters("zoh", "ideal")
STIFFNESS = 700.0  # N/m: all that this device has


def noisy_periods(seed: int) -> Periods:
    """Thirteen pairs of periods of a spring that a multisine pulls, read with a white noise of 1 µm."""
    rng = np.random.default_rng(seed)
    pulled = np.zeros(LINES.samples // 2 + 1, complex)
    pulled[LINES.bins] = np.exp(2j * np.pi * rng.random(LINES.bins.size))
    force = np.tile(20.0 * np.fft.irfft(pulled, LINES.samples), 14)
    trace = trace_of(force / STIFFNESS + 1e-6 * rng.normal(size=force.size), force)
    return periods_of(trace, LINES, CONVERTERS, senses=False)


def test_a_radius_is_a_quantile_of_f() -> None:
    for count in (2, 5, 40):
        assert _quantile(count, 1e-4) == pytest.approx(scipy.stats.f.isf(1e-4, 2, 2 * (count - 1)))


@pytest.mark.thorough
def test_as_many_values_lie_outside_their_circles_as_the_confidence_states(
    monkeypatch: pytest.MonkeyPatch, figures: Any
) -> None:
    """The 99.9 % are of all circles together, of which no test could count the misses; so the circles are drawn for
    10 % and 1 % of misses each. They are somewhat wide, because of the overlap: 0.8 and 0.7 of that."""
    experiments = [noisy_periods(seed) for seed in range(300)]
    size = LINES.bins.size
    shares = {}
    for outside in (0.1, 0.01):
        monkeypatch.setattr(periodic_excitation, "CONFIDENCE", 1.0 - outside * size)
        found = [impedance_of([one], LINES.frequency, 1000.0, 0.0, CONVERTERS).device for one in experiments]
        late = CONVERTERS.response(LINES.frequency, 1000.0, 0.0)
        true = (STIFFNESS * late / (2j * np.pi * LINES.frequency))[:, None, None]
        missed = [np.abs(one.value - true) > one.uncertainty for one in found]
        shares[outside] = float(np.mean(missed)) / outside
    figures.most("impedance values outside circles drawn for 10 %, of these", shares[0.1])
    assert 0.7 < shares[0.1] < 0.9
    assert 0.3 < shares[0.01] < 0.8


THREE_HANDS = """
version: 1
rate: 1000
scheme: exact
device: {{clock: lockstep, mass: [0.15, 0.3, 0.2], friction: [0.8, 1.5, 1.0], delay: 2, force_limit: 20}}
mock: {{quantum: {quantum}, noise: {noise}}}
modules:
  a: {{type: device, channel: 0}}
  b: {{type: device, channel: 1}}
  c: {{type: device, channel: 2}}
  wall: {{type: ground}}
  p: {{type: mass, mass: {mass}}}
  q: {{type: mass, mass: 0.5}}
  ap: {{type: viscoelastic, between: [a, p], stiffness: {coupling}, damping: 1}}
  bp: {{type: viscoelastic, between: [b, p], stiffness: 300, damping: 2}}
  bq: {{type: viscoelastic, between: [b, q], stiffness: {coupling}, damping: 1}}
  cq: {{type: viscoelastic, between: [c, q], stiffness: 30, damping: 1}}
  aw: {{type: viscoelastic, between: [a, wall], stiffness: 900, damping: 5}}
  bw: {{type: viscoelastic, between: [b, wall], stiffness: 600, damping: 5}}
  cw: {{type: viscoelastic, between: [c, wall], stiffness: 1200, damping: 6}}
"""


def test_a_hand_that_moves_by_few_counts_while_another_is_excited_is_within_the_uncertainty() -> None:
    """The rounding is not like noise here: it follows the motion and is the same in every period."""
    outside, certain = 0, []
    for quantum, noise, coupling, mass in ((9e-7, 0.0, 30.0, 0.5), (2e-7, 0.0, 1.0, 0.3), (8e-7, 1e-6, 3.0, 0.9)):
        scene = parse_scene(THREE_HANDS.format(quantum=quantum, noise=noise, mass=mass, coupling=coupling))
        found = measure_impedance(scene)
        predicted = predict_impedance(scene, found.frequency)
        for kind in ("device", "rendered", "closed_loop"):
            circles, own = getattr(found, kind), np.arange(3)
            outside += np.count_nonzero(np.abs(circles.value - getattr(predicted, kind)) > circles.uncertainty)
            certain.append(circles.uncertainty[:, own, own] / np.abs(circles.value[:, own, own]))
    assert outside == 0
    assert np.median(certain) < 0.01  # and it is no wide circle that holds them
