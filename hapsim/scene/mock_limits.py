"""Limits of the built-in mock: combinations that it does not have, and motions that take it too long."""

from __future__ import annotations

import math

import numpy as np

from .scene import Scene

MOST_CHANGES = 1000  # of inputs
_MOST_STEPS = 1000.0  # in a sample, of bodies whose mass is a matrix or that a transmission moves
_NOISE_STEPS = 10.0  # in a period of the force noise's band


def mock_refusal(scene: Scene) -> str:
    """Returns why the scene's mock cannot run; "" if it can."""
    mock = scene.mock_device
    times = scene.mock.inputs.values() if scene.mock else ()
    if (count := sum(map(len, times))) > MOST_CHANGES:
        return f"mock.inputs: found {count} times, expected at most {MOST_CHANGES} of all inputs together"
    damped, sprung = np.add(mock.friction, mock.hand.damping), np.add(mock.stiffness, mock.hand.stiffness)
    if mock.mass_matrix is not None:
        if mock.is_driven:
            return "mock: found cogging, force_noise or saturation with a mass that is a matrix, expected none of them"
        inverse = np.abs(np.linalg.inv(mock.mass_matrix))
        steps = max(float((inverse @ damped).max()), math.sqrt((inverse @ sprung).max())) / scene.rate
        found = "its friction, and the hand that holds it, move a mass that is a matrix"
        return _too_fast(found, steps, "a larger mass, or less of both")
    if not mock.is_driven:
        return ""
    if "acceleration" in scene.sensed:
        return "mock: found cogging, force_noise or saturation with a sensed acceleration, expected none of them"
    fastest = _NOISE_STEPS * mock.force_noise.band if mock.force_noise else 0.0
    for mass, drive, b, k in zip(mock.mass, mock.drive, damped.tolist(), sprung.tolist(), strict=True):
        least = min([mass, *(held for _, held in mock.grips)])
        lighter = min(drive.motor_mass or least, least - drive.motor_mass)
        if not lighter > 0.0:
            return f"mock.grips: found a mass of {least:g} kg, expected more than the motor's ({drive.motor_mass:g} kg)"
        fastest = max(fastest, (b + 2.0 * drive.damping) / lighter, math.sqrt((k + 2.0 * drive.stiffness) / lighter))
    less = "less stiffness or damping, more mass, or a smaller band of the noise"
    return _too_fast("its transmission, hand or force noise moves it", fastest / scene.rate, less)


def _too_fast(what: str, steps: float, instead: str) -> str:
    if steps <= _MOST_STEPS:
        return ""
    return f"mock: {what} in 1/{steps:.3g} of a sample period; expected at least 1/{_MOST_STEPS:g}: {instead}"
