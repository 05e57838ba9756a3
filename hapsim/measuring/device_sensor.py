"""Compares a device's sensed acceleration with that of the fitted device (`device_fit`) under the forces it was sent.

The fitted acceleration is that of the positions and forces. It does not depend on the sensor, and jumps where the force
does. Just before and just after a sample it is a[0] and a[1]. The sensed one is regressed on both and a constant:

    sensed = scale ((1 - age) a[0] + age a[1]) + offset + noise

Uncertainties include the scatter from swing to swing, as the rest of a sensor that lags is not white. They are upper
bounds: those of mass and constant force are added as if the positions did not tie both to the fitted acceleration.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from firmware_protocol import schema
from hapsim.measuring.converters import Converters
from hapsim.measuring.device_fit import DeviceFit, Estimate, sensed_and_fitted
from hapsim.measuring.device_motion import Motion
from hapsim.units import Units

_NEAR, _FAR = 0.01, 0.25  # sample periods from a sample to the force just before or after it, at least and at most
_CERTAIN = 4.0  # uncertainties
_SCALE_OFF = 0.1
_OFFSET_OFF = 0.01  # of the sensed acceleration, rms
_SINGULAR = 1e-9  # of the largest: a column without any motion
_LAGS = 0.05, 2.0  # of the acceleration, rms, and times the noise: the rest that a sensor without a lag does not leave


@dataclass(frozen=True)
class AccelerationSensor:
    """A device's acceleration sensor. Accelerations are in m/s²."""

    scale: Estimate
    """Sensed over true acceleration; ideally 1."""
    offset: Estimate
    noise: float
    """Noise at rest, rms, with its rounding."""
    residual: float
    """Rest of the sensed acceleration beside scale, offset and age, rms; ideally the noise alone."""
    rms: float
    """The sensed acceleration, rms."""
    age: int | None
    """As `device.acceleration_age`; None if the forces do not show it."""


def acceleration_sensor(
    motions: list[Motion], fit: DeviceFit, noise: float, count_m: float, rate_hz: float, converters: Converters
) -> AccelerationSensor | None:
    """Returns the acceleration sensor of a device; None if it has none. `noise`: m/s² rms; `count_m`: m per count."""
    apart = min(max(_CERTAIN * fit.delay.uncertainty, _NEAR), _FAR)
    swing, sensed, after, before = sensed_and_fitted(motions, fit, apart, count_m, rate_hz, converters)
    if np.isnan(sensed).any():
        return None
    columns = np.column_stack([after, np.ones_like(after), before - after])
    inverse = np.linalg.pinv(columns.T @ columns, _SINGULAR)
    scale, offset, change = found = inverse @ columns.T @ sensed
    left = sensed - columns @ found
    residual = math.sqrt(float(left @ left) / max(left.size - found.size, 1))
    by_swing = np.zeros((len(fit.swings), found.size))
    np.add.at(by_swing, swing, columns * left[:, None])
    scatter = np.linalg.norm(by_swing @ inverse, axis=0)
    of_scale, of_offset, of_change = np.maximum(residual * np.sqrt(np.diag(inverse)), scatter)
    is_aged, is_known = inverse[2, 2] > 0.0, abs(change / scale - 0.5) > _CERTAIN * abs(of_change / scale)
    return AccelerationSensor(
        scale=Estimate(float(scale), math.hypot(of_scale, scale * fit.mass.uncertainty / fit.mass.value)),
        offset=Estimate(float(offset), math.hypot(of_offset, fit.constant_force.uncertainty / fit.mass.value)),
        noise=noise,
        residual=residual,
        rms=math.sqrt(float(np.mean(sensed**2))),
        age=int(change / scale > 0.5) if is_aged and is_known else None,
    )


def has_right_scale(sensor: AccelerationSensor) -> bool:
    """Returns whether sign and scale are right, within a tenth."""
    return abs(sensor.scale.value - 1.0) < _SCALE_OFF


def sensor_warnings(sensor: AccelerationSensor, channel: int, declared_age: int, units: Units) -> list[str]:
    """Returns what is wrong with the sensor, in sentences without a full stop. `declared_age`: of the scene."""
    (part,) = (one for one in schema.SENSED if one.name == "acceleration")
    register = part.scale_register + part.register_step * channel
    scale, offset, sentences = sensor.scale.value, sensor.offset, []
    if not has_right_scale(sensor):
        what = "its sign is wrong" if scale < 0.0 else "its scale is wrong"
        mend = f"multiply the scale in the firmware (register {register}) by {1.0 / scale:.3g}"
        sentences.append(f"the sensed acceleration is {scale:.3g} times that of the motion: {what}; {mend}")
    if abs(offset.value) > max(_OFFSET_OFF * sensor.rms, _CERTAIN * offset.uncertainty):
        size = units(offset.value, "m/s²", ".3g")
        sentences.append(
            f"the sensed acceleration has an offset of {size}, {abs(offset.value) / sensor.rms:.2g} of what it sensed, "
            "rms: gravity, or a sensor that needs its zero"
        )
    if sensor.age is not None and sensor.age != declared_age:
        sentences.append(
            f"the sensed acceleration is that just {('after', 'before')[sensor.age]} a force begins to act: found "
            f"device.acceleration_age: {declared_age}, expected {sensor.age}"
        )
    share, times = _LAGS
    if sensor.residual > max(share * sensor.rms, times * sensor.noise):
        size, noise = units(sensor.residual, "m/s²", ".2g"), units.number(sensor.noise, "m/s²", ".2g")
        sentences.append(
            f"the sensed acceleration follows the motion within {size} rms, but its noise is only {noise}: it lags, as "
            "a sensor of a low bandwidth does, or the fitted device is not this one"
        )
    return sentences
