"""The mock's mass in continuous time, moved in closed form over any interval of constant force.

    m x'' + b0 x' = F - Fc sign(x')

No step method: whatever the interval, position, velocity and the integral of the position are exact to rounding. With
Coulomb friction the instant at which the mass comes to rest has a closed form too; it then sticks, or sets off again.
"""

from __future__ import annotations

import math

import numpy as np

from hapsim.compiled import jit

BODY = np.dtype(
    [
        ("mass", np.float64),  # kg
        ("friction", np.float64),  # N·s/m
        ("coulomb", np.float64),  # N
        ("position", np.float64),  # m
        ("velocity", np.float64),  # m/s
        ("area", np.float64),  # m·s, integral of the position since it was last set to zero
    ]
)


@jit
def _phi(u):
    """phi1, phi2, phi3 of u >= 0: phi1 = (1 - exp(-u))/u, phi2 = (1 - phi1)/u, phi3 = (1/2 - phi2)/u.

    For small u by the series of phi3, upwards from which the others follow without cancellation.
    """
    if u > 1.0:
        phi1 = -math.expm1(-u) / u
        phi2 = (1.0 - phi1) / u
        return phi1, phi2, (0.5 - phi2) / u
    phi3 = 0.0
    for j in range(18, 0, -1):
        phi3 = (1.0 - phi3 * u) / (j + 2)
    phi3 *= 0.5
    phi2 = 0.5 - u * phi3
    return 1.0 - u * phi2, phi2, phi3


@jit
def _glide(body, force, h):
    """Moves under a constant total force, without Coulomb friction."""
    phi1, phi2, phi3 = _phi(body.friction / body.mass * h)
    push = force / body.mass
    v = body.velocity
    body.area += h * (body.position + h * (phi2 * v + h * phi3 * push))
    body.position += h * (phi1 * v + h * phi2 * push)
    body.velocity = v + h * phi1 * (push - body.friction / body.mass * v)


@jit
def _time_to_rest(body, force):
    """When the velocity crosses zero under a constant total force: infinity where it never does."""
    if not body.velocity * force < 0.0:
        return math.inf
    u = -body.friction * body.velocity / force
    if u > 1.0:
        return body.mass / body.friction * math.log1p(u)
    shrunk = math.log1p(u) / u if u > 0.0 else 1.0
    return -body.mass * body.velocity / force * shrunk


@jit
def move(body, force, h):
    """Moves the body for `h` seconds under a constant `force` in N."""
    if body.coulomb == 0.0:
        _glide(body, force, h)
        return
    while h > 0.0:
        if body.velocity == 0.0 and abs(force) <= body.coulomb:
            body.area += h * body.position
            return
        direction = math.copysign(1.0, body.velocity if body.velocity != 0.0 else force)
        total = force - body.coulomb * direction
        rest = _time_to_rest(body, total)
        if rest >= h:
            _glide(body, total, h)
            return
        _glide(body, total, rest)
        body.velocity = 0.0
        h -= rest


@jit
def strike(body, impulse):
    """Gives the body an impulse in N·s."""
    body.velocity += impulse / body.mass
