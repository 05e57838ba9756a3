"""The mock's mass in continuous time, moved in closed form over any interval with a level or ramping force.

    m x'' + b0 x' + k0 x = F + s t + P - Fc sign(x')

F and its slope s are commanded; P, the hand's push, is constant. b0 and k0 are those of device and hand together. The
spring's rest position is x = 0.

Position, velocity and the integral of the position are exact to rounding over any interval. The instant at which
Coulomb friction brings the mass to rest also has a closed form; the mass then sticks, or sets off again. Only a ramp
under Coulomb friction is replaced by `_SLICES` level forces.

Bodies whose mass is a matrix move together (`move_together`), by their Taylor series over steps short enough that it
ends.

Bodies move by a function behind an address (`move_of`), so that a device without spring and dry friction does not
compile their code.
"""

from __future__ import annotations

import math

import numpy as np
from numba import types
from numpy.typing import NDArray

from firmware_protocol.schema import MAX_CHANNELS
from hapsim.compiling import helper, inlined
from hapsim.compiling.native import address_in_memory, function_at, native, record_at

BODY = np.dtype(
    [
        ("mass", np.float64),  # kg
        ("friction", np.float64),  # N·s/m
        ("stiffness", np.float64),  # N/m, >= 0: a real spring to x = 0
        ("coulomb", np.float64),  # N
        ("push", np.float64),  # N, of the hand
        ("slope", np.float64),  # N/s, of the commanded force
        ("position", np.float64),  # m
        ("velocity", np.float64),  # m/s
        ("area", np.float64),  # m·s, integral of the position since it was last set to zero
    ]
)

COUPLING = np.dtype(
    [
        ("inverse", np.float64, (MAX_CHANNELS, MAX_CHANNELS)),  # of the mass matrix, 1/kg
        ("force", np.float64, MAX_CHANNELS),  # N, commanded, at the beginning of an interval
        ("impulse", np.float64, MAX_CHANNELS),  # N·s, at that instant
        *((name, np.float64, MAX_CHANNELS) for name in ("older", "old", "new", "pull")),  # terms of a series
    ]
)
"""Bodies that move each other."""

_TERMS = 22  # of the series: the next is below 1e-18 of the first
_SERIES_END = 4.0  # of b0 h/m and of k0 h²/m: up to here by series, beyond it by exponentials that no longer cancel
_MAX_STOPS = 1000  # within one interval
_SLICES = 16  # of a ramp under Coulomb friction


@helper
def _advance(body, force, h, phi):
    """Moves a body under a force that begins with `force` and has the body's slope, without Coulomb friction. `phi`: of
    `_phi` or `_spring_phi`.

    The displacement z = x - x(0) obeys m z'' + b0 z' + k0 z = F - k0 x(0): small intervals add small amounts, and a
    mass at rest where the spring holds the force stays there.
    """
    phi1, phi2, phi3, phi4 = phi
    damped, sprung = body.friction / body.mass, body.stiffness / body.mass
    push, ramp = (force - body.stiffness * body.position) / body.mass, h * body.slope / body.mass
    v = body.velocity
    body.area += h * (body.position + h * (phi2 * v + h * (phi3 * push + phi4 * ramp)))
    body.position += h * (phi1 * v + h * (phi2 * push + phi3 * ramp))
    body.velocity = v + h * (phi1 * (push - damped * v) + phi2 * ramp - h * phi2 * sprung * v)


@helper
def _phi(u):
    """phi1 to phi4 of u >= 0: phi1 = (1 - exp(-u))/u and phi[n + 1] = (1/n! - phi[n])/u.

    For small u by the series of phi4, from which the others follow without cancellation.
    """
    if u > 1.0:
        phi1 = -math.expm1(-u) / u
        phi2 = (1.0 - phi1) / u
        phi3 = (0.5 - phi2) / u
        return phi1, phi2, phi3, (1.0 / 6.0 - phi3) / u
    phi4 = 0.0
    for j in range(18, 0, -1):
        phi4 = (1.0 - phi4 * u) / (j + 3)
    phi4 /= 6.0
    phi3 = 1.0 / 6.0 - u * phi4
    phi2 = 0.5 - u * phi3
    return 1.0 - u * phi2, phi2, phi3, phi4


@helper
def _spring_phi(u, w):
    """phi1 to phi4 of u = b0 h/m and w = k0 h²/m.

    z'' + (b0/m) z' + (k0/m) z = 0 from z = 0, z' = 1 reaches z = h phi1; its integrals are h² phi2, h³ phi3 and
    h⁴ phi4. Integrating the equation of motion gives phi[n] = 1/n! - u phi[n+1] - w phi[n+2].
    """
    if w == 0.0:
        return _phi(u)
    if u <= _SERIES_END and w <= _SERIES_END:
        return _phi_by_series(u, w)
    discriminant = 0.25 * u * u - w
    if 36.0 * discriminant > u * u:
        return _phi_of_two_rates(u, w, math.sqrt(discriminant))
    return _phi_of_a_swing(u, w, discriminant)


@helper
def _phi_by_series(u, w):
    """Returns phi1 to phi4 for u, w up to 4 and any discriminant: downwards from a negligible phi[n], scaled by n!."""
    nearer, farther = 0.0, 0.0
    for n in range(22 if u + w <= 1.0 else 42, 2, -1):
        nearer, farther = 1.0 - (u * nearer + w * farther / (n + 2)) / (n + 1), nearer
    phi3, phi4 = nearer / 6.0, farther / 24.0
    phi2 = 0.5 - u * phi3 - w * phi4
    return 1.0 - u * phi2 - w * phi3, phi2, phi3, phi4


@helper
def _phi_of_two_rates(u, w, root):
    """Returns phi1 to phi4 for two real decays, the faster at least twice the slower, as their divided difference. The
    slower one, u/2 - root, is computed without that difference: it goes to zero with the spring."""
    fast = 0.5 * u + root
    slow = w / fast
    fast1, fast2, fast3, _ = _phi(fast)
    slow1, slow2, slow3, _ = _phi(slow)
    apart = 2.0 * root
    phi1 = (math.exp(-slow) - math.exp(-fast)) / apart
    return phi1, (slow1 - fast1) / apart, (slow2 - fast2) / apart, (slow3 - fast3) / apart


@helper
def _phi_of_a_swing(u, w, discriminant):
    """Returns phi1 to phi4 for a decaying oscillation, or two close or equal decays with w > 3, by upward recursion."""
    if discriminant < 0.0:
        root = math.sqrt(-discriminant)
        decay = math.exp(-0.5 * u)
        cosine, sine = decay * math.cos(root), decay * math.sin(root) / root
    else:
        root = math.sqrt(discriminant)
        decay = math.exp(-w / (0.5 * u + root))  # the slower one
        cosine = decay * 0.5 * (1.0 + math.exp(-2.0 * root))
        sine = decay * (-math.expm1(-2.0 * root) / (2.0 * root) if root > 0.0 else 1.0)
    phi2 = (1.0 - cosine - 0.5 * u * sine) / w
    phi3 = (1.0 - sine - u * phi2) / w
    return sine, phi2, phi3, (0.5 - phi2 - u * phi3) / w


@helper
def _swing(body, force, h):
    """Moves a body with or without a spring, without Coulomb friction."""
    _advance(body, force, h, _spring_phi(body.friction / body.mass * h, body.stiffness / body.mass * h * h))


@helper
def _time_to_rest(body, force):
    """Returns the time (s) at which the velocity crosses zero under a constant total force, without a spring; infinity
    if it never does."""
    if not body.velocity * force < 0.0:
        return math.inf
    u = -body.friction * body.velocity / force
    if u > 1.0:
        return body.mass / body.friction * math.log1p(u)
    shrunk = math.log1p(u) / u if u > 0.0 else 1.0
    return -body.mass * body.velocity / force * shrunk


@helper
def _swing_to_rest(body, force, direction):
    """Returns the time (s) at which a mass on the spring, moving in `direction` or about to, next comes to rest;
    infinity if it never does.

    v = exp(-d t) (|v(0)| C - (d |v(0)| + braking) S) in that direction, with d = b0/2m and either C, S = cos w t,
    sin(w t)/w, zero at tan w t = w |v(0)| / (d |v(0)| + braking), or the same with cosh, sinh and tanh.
    """
    half = 0.5 * body.friction / body.mass
    sprung = body.stiffness / body.mass
    speed = abs(body.velocity)
    braking = -direction * (force - body.stiffness * body.position) / body.mass
    discriminant = half * half - sprung
    if discriminant < 0.0:
        frequency = math.sqrt(-discriminant)
        return math.atan2(frequency * speed, half * speed + braking) / frequency
    root = math.sqrt(discriminant)
    braking += sprung / (half + root) * speed
    if not braking > 0.0:
        return math.inf
    u = 2.0 * root * speed / braking
    return math.log1p(u) / (2.0 * root) if u > 0.0 else speed / braking


@helper
def _move_with_stops(body, force, h):
    """Moves a body under a level force and Coulomb friction.

    On a spring half a period passes between two stops. On a mass that has not stuck after `_MAX_STOPS` friction has
    little effect: the rest of the interval is computed without it.
    """
    for _ in range(_MAX_STOPS):
        pull = force - body.stiffness * body.position
        if body.velocity == 0.0 and abs(pull) <= body.coulomb:
            body.area += h * body.position
            return
        direction = math.copysign(1.0, body.velocity if body.velocity != 0.0 else pull)
        total = force - body.coulomb * direction
        rest = _swing_to_rest(body, total, direction) if body.stiffness != 0.0 else _time_to_rest(body, total)
        if not rest < h:
            _swing(body, total, h)
            return
        _swing(body, total, rest)
        body.velocity = 0.0
        h -= rest
    _swing(body, force, h)


@helper
def acceleration(body, force):
    """Returns the acceleration, in m/s², under this commanded force, in N, and all others; 0 where the mass sticks."""
    pull = force + body.push - body.stiffness * body.position - body.friction * body.velocity
    if body.coulomb != 0.0:
        if body.velocity == 0.0 and abs(pull) <= body.coulomb:
            return 0.0
        pull -= math.copysign(body.coulomb, body.velocity if body.velocity != 0.0 else pull)
    return pull / body.mass


@helper
def strike(body, impulse):
    """Gives the body an impulse in N·s."""
    body.velocity += impulse / body.mass


@helper
def strike_together(bodies, count, coupling):
    """Gives bodies whose mass is a matrix the impulses of `coupling`."""
    for i in range(count):
        for j in range(count):
            bodies[i].velocity += coupling.inverse[i, j] * coupling.impulse[j]


_MOVE = types.void(types.uint64, types.float64, types.float64)
_body_at, _call = record_at(BODY), function_at(_MOVE)


@inlined
def move(how, body, force, h):
    """Moves the body for `h` seconds under a commanded force that begins with `force`, in N, and has the body's slope,
    and under its hand's push. `how`: from `move_of`."""
    _call(how, (address_in_memory(body), force, h))


@native(_MOVE.return_type, *_MOVE.args)
def move_gliding(body, force, h):
    """Moves a body without spring and Coulomb friction."""
    body = _body_at(body)
    _advance(body, force + body.push, h, _phi(body.friction / body.mass * h))


@native(_MOVE.return_type, *_MOVE.args)
def move_with_spring_or_friction(body, force, h):
    """Moves a body with or without a spring and Coulomb friction."""
    body = _body_at(body)
    force += body.push
    if body.coulomb == 0.0:
        _swing(body, force, h)
        return
    slope, slices = body.slope, 1 if body.slope == 0.0 else _SLICES
    body.slope = 0.0
    for i in range(slices):
        _move_with_stops(body, force + slope * h * (i + 0.5) / slices, h / slices)
    body.slope = slope


@helper
def move_together(bodies, count, coupling, h):
    """Moves `count` bodies whose mass is a matrix for `h` seconds. `coupling`: a COUPLING with their forces.

    M x'' = F + P + s t - b0 x' - k0 x, derived n times, gives each term of the series from the two before it.
    """
    rate = 0.0  # per second, at which no motion is faster
    for i in range(count):
        damped, sprung = 0.0, 0.0
        for j in range(count):
            damped += abs(coupling.inverse[i, j]) * bodies[j].friction
            sprung += abs(coupling.inverse[i, j]) * bodies[j].stiffness
        rate = max(rate, damped, math.sqrt(sprung))
    steps = max(1.0, math.ceil(rate * h))
    for step in range(np.int64(steps)):
        _step_together(bodies, count, coupling, step * (h / steps), h / steps)


@helper
def _step_together(bodies, count, coupling, since, h):
    """Adds the terms of the series, scaled by h: T[n + 2] = M⁻¹ h² (pull - b0 (n + 1) T[n + 1]/h - k0 T[n]) / ((n + 1)
    (n + 2)), with x = T[0] and h x' = T[1] at first. `since`: seconds since the forces began to act."""
    older, old, new = coupling.older, coupling.old, coupling.new
    for i in range(count):
        older[i], old[i] = bodies[i].position, h * bodies[i].velocity
        bodies[i].area += h * (older[i] + 0.5 * old[i])
        bodies[i].position += old[i]
    for n in range(_TERMS):
        for j in range(count):
            pull = -bodies[j].friction * (n + 1) * old[j] / h - bodies[j].stiffness * older[j]
            if n == 0:
                pull += coupling.force[j] + bodies[j].push + bodies[j].slope * since
            elif n == 1:
                pull += bodies[j].slope * h
            coupling.pull[j] = pull
        for i in range(count):
            new[i] = 0.0
            for j in range(count):
                new[i] += coupling.inverse[i, j] * coupling.pull[j]
            new[i] *= h * h / ((n + 1) * (n + 2))
        for i in range(count):
            older[i], old[i] = old[i], new[i]
            bodies[i].position += new[i]
            bodies[i].velocity += (n + 2) * new[i] / h
            bodies[i].area += h * new[i] / (n + 3)


def move_of(bodies: NDArray[np.void]) -> int:
    """Returns the address of the function that moves these bodies, an array of BODY."""
    gliding = not (bodies["stiffness"].any() or bodies["coulomb"].any())
    return (move_gliding if gliding else move_with_spring_or_friction).address()
