"""The motor and the transmission of the mock's bodies, moved exactly: belt, backlash, motor lag, cogging, dry friction.

    motor   m x'' = f - F sin(2 pi x/pitch) + noise - b x' - p
    handle  m x'' = P - k0 x - b x' + p             P: the hand's push, k0: its spring and the device's own

The commanded force u reaches the motor as f with lag f' = u - f. The transmission presses motor and handle apart with
p = k d + c d', d the motor's lead. With a backlash it presses only where d is beyond a half of it, by that much, and
never pulls a tooth back that leaves. Dry friction acts on one of the two.

Between two events (meshing, leaving mesh, stopping, breaking loose) the motion is smooth, and its Taylor series over
steps short enough ends. An event function whose series bounds it away from zero has no event; one that is monotone or
concave has at most one, which bisection of the series locates to rounding; any other makes the step shorter.
"""

from __future__ import annotations

import math

import numpy as np

from hapsim.compiling import helper
from hapsim.device.mock.sampler import begin_piece, noise

_TERMS = 26  # of the series: the next is below 1e-17 of the first
_MOST_STEPS = 100_000  # of one force; a motion with more has left the range of numbers
_HALVINGS = 40
_TOUCHING = 0.5 * (1.0 - 1e-9)  # of the backlash
_BISECTIONS = 60
_GONE = 40.0  # time constants after which a lag is over: exp(-40) is rounding
_NOISE_STEPS = 10.0  # in a period of the noise's band

DRIVE = np.dtype(
    [
        ("motor_mass", np.float64),  # kg; 0: motor and handle are one mass
        ("stiffness", np.float64),  # N/m, of the transmission
        ("damping", np.float64),  # N·s/m
        ("backlash", np.float64),  # m
        ("motor_friction", np.float64),  # N·s/m, the part of the body's that brakes the motor
        ("sensor", np.int64),  # 0: reads the motor; 1: the handle
        ("rough", np.int64),  # the one with dry friction
        ("lag", np.float64),  # s
        ("cogging", np.float64),  # N
        ("wave", np.float64),  # rad/m, 2 pi/pitch
        ("noise", np.float64),  # N rms
        ("corner", np.float64),  # rad/s, of the noise
        ("softness", np.float64),  # 1/N², of the saturation
        ("seed", np.uint64),
        ("state", np.uint64),
        ("force", np.float64),  # N, that has reached the motor
        ("noise_force", np.float64),  # N
        ("position", np.float64, 2),  # m, of motor and handle
        ("velocity", np.float64, 2),  # m/s
        ("mesh", np.int64),  # -1, 1: the side on which the teeth press; 0: neither
        ("way", np.int64),  # -1, 1: direction of the sliding that dry friction brakes; 0: it sticks
        ("is_loose", np.int64),  # 1: it has just broken loose, and does not move yet
        ("x", np.float64, (2, _TERMS)),  # series of the positions, in shares of a step
        ("pull", np.float64, _TERMS),  # of the force on the one with dry friction, without that
        ("belt", np.float64, _TERMS),  # of k d + c d'
        ("sine", np.float64, _TERMS),
        ("cosine", np.float64, _TERMS),
        ("event", np.float64, _TERMS),  # of a function that is positive until the event
    ],
    align=True,
)


@helper
def begin_drive(drive, body):
    """Starts motor and handle where the body is, without a force, and the noise anew."""
    drive.position[:] = body.position
    drive.velocity[:] = body.velocity
    drive.force, drive.state = 0.0, drive.seed
    drive.noise_force = noise(drive, drive.noise)


@helper
def saturated(drive, force):
    """Returns the force, in N, that the motor gives where this one is commanded."""
    return force / math.sqrt(1.0 + drive.softness * force * force)


@helper
def advance_drive(drive, body, converter, commands, depth, channel, n, acts, h):
    """Moves one channel's motor and handle through sample n, which lasts `h` seconds. The commanded forces act for the
    first `acts` of them. `commands`: as of `advance_body`."""
    gone, motor = 0.0, drive.motor_mass if drive.motor_mass > 0.0 else body.mass
    for i in range(converter.pieces_in_use):
        piece = converter.pieces[i]
        force, impulse = begin_piece(body, converter, piece, commands, depth, channel, n)
        drive.velocity[0] += impulse / motor
        duration = piece.duration * acts if i + 1 < converter.pieces_in_use else acts - gone
        move_driven(drive, body, force, duration)
        gone += duration
    body.slope = 0.0
    if acts < h:
        move_driven(drive, body, 0.0, h - acts)


@helper
def move_driven(drive, body, force, h):
    """Moves motor and handle for `h` seconds under a commanded force that begins with `force` and has the body's
    slope, and the body with the one whose position is read. The noise is constant within each of its steps."""
    steps = max(1, math.ceil(h * drive.corner * (_NOISE_STEPS / (2.0 * math.pi)))) if drive.noise > 0.0 else 1
    if drive.motor_mass == 0.0:
        drive.velocity[1] = drive.velocity[0]
    for i in range(steps):
        _move(drive, body, force + body.slope * (i * (h / steps)), h / steps)
        if drive.noise > 0.0:
            kept = math.exp(-drive.corner * h / steps)
            drive.noise_force = kept * drive.noise_force + noise(drive, drive.noise * math.sqrt(1.0 - kept * kept))
    read = drive.sensor
    body.position, body.velocity = drive.position[read], drive.velocity[read]


@helper
def _move(drive, body, force, h):
    """Moves motor and handle from event to event, under a straight line of the commanded force."""
    base, since = force - body.slope * drive.lag, 0.0  # N that the motor's force nears
    off = drive.force - base if drive.lag > 0.0 else 0.0  # and by which it is off at first
    lead, ahead = drive.position[0] - drive.position[1], drive.velocity[0] - drive.velocity[1]
    drive.mesh = 1 if lead > 0.0 else -1
    beyond = drive.mesh * lead - 0.5 * drive.backlash
    if drive.backlash > 0.0 and not min(beyond, drive.stiffness * beyond + drive.damping * drive.mesh * ahead) > 0.0:
        drive.mesh = 0
    drive.is_loose = 0
    fastest = _rate_of(drive, body)
    most = abs(base) + abs(body.slope) * h + abs(off) + abs(drive.noise_force)
    for _ in range(_MOST_STEPS):
        left = h - since
        step = min(left, 1.0 / max(fastest + _cogging_rate(drive, body, most), 1e-300))
        lagging = off * math.exp(-since / drive.lag) if since < _GONE * drive.lag else 0.0
        if lagging != 0.0:
            step = min(step, drive.lag)
        _expand(drive, body, base + body.slope * since + drive.noise_force, lagging, step)
        share, event = _next_event(drive, body)
        _advance(drive, body, share, step)
        _act_on(drive, event)
        since += share * step
        if (share == 1.0 and step == left) or since >= h:  # an event at the very end leaves nothing
            drive.force = base + body.slope * h + (off * math.exp(-h / drive.lag) if drive.lag > 0.0 else 0.0)
            return
    drive.position[:] = math.inf


@helper
def _rate_of(drive, body):
    """Returns a rate, per second, at which no motion of a body behind this drive is faster, without its cogging."""
    motor = drive.motor_mass
    if motor == 0.0:
        return max(body.friction / body.mass, math.sqrt(body.stiffness / body.mass))
    lighter = min(motor, body.mass - motor)
    damped, sprung = body.friction + 2.0 * drive.damping, body.stiffness + 2.0 * drive.stiffness
    return max(damped / lighter, math.sqrt(sprung / lighter))


@helper
def _cogging_rate(drive, body, force):
    """Returns the rate, per second, at which the cogging changes, and begins to. `force`: the most on the motor, N."""
    if drive.cogging == 0.0:
        return 0.0
    force += drive.cogging + body.coulomb + drive.stiffness * abs(drive.position[0] - drive.position[1])
    if drive.motor_mass == 0.0:
        force += abs(body.push) + body.stiffness * abs(drive.position[0])
    motor = drive.motor_mass if drive.motor_mass > 0.0 else body.mass
    return drive.wave * abs(drive.velocity[0]) + math.sqrt(drive.wave * force / motor)


@helper
def _expand(drive, body, force, lagging, h):
    """Sets the series of the positions, of the pull on the one with dry friction and of the belt over `h` seconds, and
    the way of the sliding. `force`: N on the motor at first; `lagging`: N of it that decay with the lag."""
    x, motor, rough, is_two = drive.x, drive.motor_mass, drive.rough, drive.motor_mass > 0.0
    for i in range(2):
        x[i, 0], x[i, 1] = drive.position[i], h * drive.velocity[i]
    presses = drive.mesh != 0
    for n in range(_TERMS - 2):
        p0, p1 = 0.0, -body.stiffness * x[1, n] - (body.friction - drive.motor_friction) * (n + 1) * x[1, n + 1] / h
        if n == 0:
            p0, p1 = force, p1 + body.push
        elif n == 1:
            p0 = body.slope * h
        p0 += lagging - drive.motor_friction * (n + 1) * x[0, n + 1] / h
        if lagging != 0.0:
            lagging *= -h / (drive.lag * (n + 1))
        if drive.cogging != 0.0:
            _expand_cogging(drive, n)
            p0 -= drive.cogging * drive.sine[n]
        drive.belt[n] = drive.stiffness * (x[0, n] - x[1, n])
        drive.belt[n] += drive.damping * (n + 1) * (x[0, n + 1] - x[1, n + 1]) / h
        if not is_two:
            p0 += p1
        elif presses:
            p = drive.belt[n]
            if n == 0:
                p -= drive.mesh * 0.5 * drive.backlash * drive.stiffness
            p0, p1 = p0 - p, p1 + p
        drive.pull[n] = p1 if rough == 1 else p0
        if n == 0 and body.coulomb != 0.0:
            _find_way(drive, body)
            p0, p1 = p0 - (body.coulomb * drive.way if rough == 0 else 0.0), p1 - body.coulomb * drive.way * rough
        if body.coulomb != 0.0 and drive.way == 0:
            p0, p1 = p0 * rough, p1 * (1 - rough)
        scale = h * h / ((n + 1) * (n + 2))
        x[0, n + 2] = p0 * scale / (motor if is_two else body.mass)
        x[1, n + 2] = p1 * scale / (body.mass - motor) if is_two else x[0, n + 2]


@helper
def _expand_cogging(drive, n):
    """Sets term n of the series of sine and cosine: s' = c theta', c' = -s theta'."""
    x, sine, cosine = drive.x, drive.sine, drive.cosine
    if n == 0:
        sine[0], cosine[0] = math.sin(drive.wave * x[0, 0]), math.cos(drive.wave * x[0, 0])
        return
    sine[n] = cosine[n] = 0.0
    for j in range(1, n + 1):
        sine[n] += j * x[0, j] * cosine[n - j]
        cosine[n] -= j * x[0, j] * sine[n - j]
    sine[n] *= drive.wave / n
    cosine[n] *= drive.wave / n


@helper
def _find_way(drive, body):
    """Sets the direction of the sliding, or that it sticks."""
    speed, pull = drive.velocity[drive.rough], drive.pull[0]
    if speed != 0.0:
        drive.way = 1 if speed > 0.0 else -1
    elif abs(pull) > body.coulomb:
        drive.way = 1 if pull > 0.0 else -1
    elif drive.is_loose == 0:
        drive.way = 0
    drive.is_loose = 0


_STOPS, _BREAKS_LOOSE, _LEAVES, _MESHES = 1, 2, 3, 4


@helper
def _next_event(drive, body):
    """Returns (share of the step up to which the series holds, the event there or 0), with the sign of its side."""
    share, event, last, lead = 1.0, 0, _TERMS - 2, drive.x
    if body.coulomb != 0.0:
        for side in (-1, 1):
            if drive.way == 0:
                for n in range(last):
                    drive.event[n] = side * drive.pull[n]
                drive.event[0] += body.coulomb
            elif side == drive.way:
                for n in range(last):
                    drive.event[n] = side * (n + 1) * lead[drive.rough, n + 1]
            else:
                continue
            share, event = _earlier(drive.event, last, share, event, _STOPS if drive.way else -side * _BREAKS_LOOSE)
    if drive.backlash > 0.0:
        half = 0.5 * drive.backlash
        for side in (-1, 1):
            if drive.mesh == -side:
                continue
            is_beyond = drive.mesh != 0 or side * (lead[0, 0] - lead[1, 0]) > half
            sign = side if drive.mesh != 0 else -side
            for n in range(last):
                drive.event[n] = sign * (drive.belt[n] if is_beyond else lead[0, n] - lead[1, n])
            drive.event[0] += (-half if drive.mesh != 0 else half) * (drive.stiffness if is_beyond else 1.0)
            share, event = _earlier(drive.event, last, share, event, _LEAVES if drive.mesh != 0 else side * _MESHES)
    return share, event


@helper
def _earlier(g, count, share, event, kind):
    """Returns (share, event) of the earlier one: these, or where g, a series that begins above 0, first falls to 0. A
    first coefficient that is 0, or is below it by rounding and grows, is no event."""
    first = 0
    while first + 3 < count and g[first] == 0.0:
        first += 1
    for _ in range(_HALVINGS):
        far, steep, bent = 0.0, 0.0, 0.0  # bounds of what is beyond the first terms, of slope and curvature too
        for n in range(count - 1, first + 2, -1):
            k = n - first
            far, steep, bent = far * share, steep * share, bent * share
            far, steep, bent = far + abs(g[n]), steep + k * abs(g[n]), bent + k * (k - 1) * abs(g[n])
        a, b, c = g[first], g[first + 1], g[first + 2]
        far = share * (abs(b) + share * (abs(c) + share * far))
        if abs(a) > far:
            return share, event
        is_monotone = abs(b) > share * (2.0 * abs(c) + share * steep)
        is_bent = 2.0 * abs(c) > share * bent
        if (is_monotone or (is_bent and a >= 0.0)) and b >= 0.0 and (is_monotone or c > 0.0):
            return share, event
        if is_monotone or (is_bent and c < 0.0):
            if value_at(g, first, count, share) > 0.0:
                return share, event
            return _fall(g, first, count, share), kind
        share, event = 0.5 * share, 0
    return share, (kind if value_at(g, first, count, share) < 0.0 else 0)


@helper
def _fall(g, first, count, after):
    """Returns the share at which g falls to 0, which it does once up to `after`, to rounding and not before it."""
    before = 0.0
    for _ in range(_BISECTIONS):
        middle = 0.5 * (before + after)
        if value_at(g, first, count, middle) > 0.0:
            before = middle
        else:
            after = middle
    return after


@helper
def value_at(g, first, count, share):
    """Returns the value of a series without the coefficients before the `first`."""
    value = 0.0
    for n in range(count - 1, first - 1, -1):
        value = value * share + g[n]
    return value


@helper
def _advance(drive, body, share, h):
    """Moves motor and handle by the series, to this share of its step."""
    for i in range(2):
        position, speed, area = 0.0, 0.0, 0.0
        for n in range(_TERMS - 1, -1, -1):
            area = area * share + drive.x[i, n] / (n + 1)
            position = position * share + drive.x[i, n]
            if n > 0:
                speed = speed * share + n * drive.x[i, n]
        drive.position[i], drive.velocity[i] = position, speed / h
        if i == drive.sensor:
            body.area += share * h * area


@helper
def _act_on(drive, event):
    """Lets motor and handle stop, break loose, leave mesh or mesh."""
    if event == _STOPS:
        drive.velocity[drive.rough] = 0.0
        if drive.motor_mass == 0.0:
            drive.velocity[:] = 0.0
    elif event == _LEAVES:
        drive.mesh = 0
    elif abs(event) == _MESHES:
        side = 1 if event > 0 else -1  # teeth that have parted may come together without a force
        if side * (drive.position[0] - drive.position[1]) >= _TOUCHING * drive.backlash:
            drive.mesh = side
    elif abs(event) == _BREAKS_LOOSE:
        drive.way, drive.is_loose = (1 if event > 0 else -1), 1
