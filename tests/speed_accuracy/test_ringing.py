"""What a string's frequencies are identified as: of a known recurrence, and of hapsim's own against closed forms."""

from __future__ import annotations

import math

import numpy as np
import pytest

from hapsim.speed_accuracy.comparison import OBJECTS, SHARP
from hapsim.speed_accuracy.ringing_string import MODES, RingingString
from hapsim.speed_accuracy.strings import StringOfMasses, frequencies_of, poles

STRING = StringOfMasses.tuned(10, damping_ratio=0.0)
OBJECT = RingingString("string", "a string", STRING)


def matrix(string: StringOfMasses) -> np.ndarray:
    """x'' = -matrix x"""
    bend = 2.0 * np.eye(string.masses) - np.eye(string.masses, k=1) - np.eye(string.masses, k=-1)
    return (string.stiffness * bend + string.bending * bend @ bend) / string.mass


@pytest.mark.parametrize("stride", [1, 3, 20])
def test_the_poles_of_a_known_recurrence_are_found(stride: int) -> None:
    pole = 0.9997 * np.exp(0.05j)
    motion = np.real(pole ** np.arange(400))
    found = sorted(poles(motion, stride), key=lambda z: -z.imag)
    assert found == pytest.approx([pole**stride, np.conj(pole) ** stride], rel=1e-10)


def test_where_nothing_moves_or_all_is_lost_there_are_no_poles() -> None:
    for motion in (np.zeros(100), np.full(100, np.nan), 1e160 * np.ones(100)):
        assert np.isnan(poles(motion, 1)).all()


@pytest.mark.parametrize("sharp", [0.0, SHARP])
def test_a_tuned_string_rings_where_its_matrix_says(sharp: float) -> None:
    string = StringOfMasses.tuned(12, sharp=sharp)
    expected = np.sqrt(np.linalg.eigvalsh(matrix(string))) / (2.0 * math.pi)
    np.testing.assert_allclose([string.frequency(mode) for mode in range(1, 13)], expected, rtol=1e-12)
    plain = StringOfMasses.tuned(12)
    assert string.frequency(5) / plain.frequency(5) == pytest.approx(1.0 + sharp)


def test_cordis_rings_where_its_closed_form_says() -> None:
    for rate in (1000.0, 20_000.0):
        warped = [rate / math.pi * math.asin(math.pi * STRING.frequency(mode) / rate) for mode in MODES]
        errors = [w / STRING.frequency(mode) - 1.0 for mode, w in zip(MODES, warped, strict=True)]
        found = OBJECT.found("cordis", "double", rate)
        assert found.errors["frequency"] == pytest.approx(max(errors, key=abs), rel=1e-5)


def test_the_exact_scheme_has_no_error_and_in_single_precision_a_small_one() -> None:
    assert abs(OBJECT.found("exact", "double", 2000.0).errors["frequency"]) < 1e-12
    assert 1e-12 < abs(OBJECT.found("exact", "single", 2000.0).errors["frequency"]) < 1e-4


def test_an_unstable_string_is_reported_as_such() -> None:
    limit = math.pi * STRING.frequency(STRING.masses)
    assert OBJECT.found("cordis", "double", 0.99 * limit).why_not == "unstable"
    assert not OBJECT.found("cordis", "double", 1.2 * limit).why_not


def test_stable_schemes_are_not_taken_for_unstable_far_above_their_nyquist_frequency() -> None:
    string = StringOfMasses.tuned(10, fundamental=150.0)
    found = RingingString("string", "a string", string).found("exact", "single", 2000.0)
    assert found.why_not == ""


def test_a_damped_mode_keeps_its_frequency() -> None:
    string = StringOfMasses.tuned(10, damping_ratio=0.02)

    def record(shape: np.ndarray, samples: int) -> np.ndarray:
        mode = int(np.argmax([abs(shape @ string.shape(j)) for j in range(1, 11)])) + 1
        omega = 2.0 * math.pi * string.frequency(mode)
        ratio = 0.02 * string.frequency(mode) / string.frequency(1)
        pole = omega * complex(-ratio, math.sqrt(1.0 - ratio**2))
        return np.real(np.exp(pole * np.arange(samples) / 10_000.0))

    found = frequencies_of(record, string, 10_000.0, MODES, explicit=False)
    assert found == pytest.approx([string.frequency(mode) for mode in MODES], rel=1e-9)


def test_the_names_of_the_objects_are_their_own() -> None:
    assert len({one.name for one in OBJECTS}) == len(OBJECTS)
