"""Transfer functions of a device's readings after a force, and of a scene's force: references for the loop's rows."""

from __future__ import annotations

import numpy as np

from hapsim.theory import Network
from hapsim.theory.device_step import DeviceStep
from hapsim.theory.interface import damper_transfer
from hapsim.theory.sample import channel_steps


def channel_answer(step: DeviceStep, z: np.ndarray, w: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Returns the device's readings after a force T²/m F z^n: its position, and its velocity times T."""
    force = [sum((f * z**-age for age, f in enumerate(row) if f), 0.0 * z) for row in step.forces]
    (aa, ab), (ba, bb) = step.motion[:2]
    determinant = (w - aa) * (w - bb) - ab * ba
    position = ((w - bb) * force[0] + ab * force[1]) / determinant
    velocity = (ba * force[0] + (w - aa) * force[1]) / determinant
    if not (step.motion[2].any() or step.forces[2].any()):
        return position, velocity
    ahead, mean_velocity = (
        (of_position * position + of_velocity * velocity + pushed) / z
        for (of_position, of_velocity), pushed in zip(step.motion[2:], force[2:], strict=True)
    )
    return position - ahead, mean_velocity


def rendered_stiffness(network: Network, z: complex) -> np.ndarray:
    """(C, C) force over position of the channels, the masses of CORDIS's scheme eliminated at one place z."""
    channels, points = network.channel_mass.size, network.channel_mass.size + network.point_mass.size
    w, matrix = np.array([z - 1.0]), np.zeros((points + 1, points + 1), complex)
    read = [channel_answer(step, 1.0 + w, w) for step in channel_steps(network)]
    for (a, b), K, B, damper in zip(network.ends, network.stiffness, network.damping, network.damper, strict=True):
        for end, sign in ((a, 1.0), (b, -1.0)):
            velocity = damper_transfer(damper, 1.0 + w, w)[0]
            if damper.senses and 0 <= end < channels:
                velocity = (read[end][1] / read[end][0])[0]
            matrix[a, end] += sign * (K + B * network.rate * velocity)
            matrix[b, end] -= sign * (K + B * network.rate * velocity)
    masses = np.arange(channels, points)
    matrix[masses, masses] += network.point_mass * network.rate**2 * w[0] ** 2 / z
    inner = np.linalg.solve(matrix[channels:points, channels:points], matrix[channels:points, :channels])
    return np.asarray(matrix[:channels, :channels] - matrix[:channels, channels:points] @ inner)
