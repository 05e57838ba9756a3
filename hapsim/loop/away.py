"""Points at other ports: what the links of one port touch and the device of another moves.

Each port publishes the positions of such points with its tick: of its hands, as its device measured them, and of
simulated masses, which move with one port, the leader. Another port's tick falls between two of these. Its links take

    x = p + age (p - p'),     age = (t - t_p) / period,

a straight line through the two newest positions, at the time t of the tick. A hand's newest position is older than the
tick, so its age is about 0 to 1 sample. A mass has its next position already, one step ahead: it is interpolated. A
damper takes the difference of two such positions, that of this tick and that of the last (`exchange._read_away`).

The times are those of the ports' clocks (port_clock.py). Beyond OLDEST samples a position is held where it is: a device
that has gone quiet does not move on. An age below -1 would need the position before the last two.
"""

from __future__ import annotations

import numpy as np

from firmware_protocol import schema
from hapsim.compiling import inlined
from hapsim.cordis.spring_energy import number_at
from hapsim.cordis.tick import program_at
from hapsim.loop.port_clock import PORT_CLOCK

OLDEST = 3.0  # samples: of a position whose frame came a sample late, behind one that was lost

MOST_PORTS = 8

POINT = np.dtype(
    [
        ("channel", np.int64),  # of a hand; -1: a mass,
        ("number", np.int64),  # of this number in the program
        ("time_ns", np.float64),  # of its newest position, by the clock of its port
        ("position", np.float64),  # m
        ("step", np.float64),  # m, from the position a sample before to that one
    ],
    align=True,
)

_EACH = (schema.MAX_CHANNELS,)

PORT = np.dtype(
    [
        ("loop", np.uint64),  # address of its LOOP
        ("clock", PORT_CLOCK),
        ("count", np.int64),  # points that other ports' links touch,
        ("points", POINT, _EACH),
        ("of_port", np.int64, _EACH),  # of each point away: the number of its port,
        ("of_point", np.int64, _EACH),  # and its number there
        ("ending", np.int64),  # RUNNING, or the code that ended this port,
        ("ended", np.int64),  # 1: and its device was disarmed
        ("held", np.int64),  # 1: its decoder has a position that the scene has not moved to,
        ("gap", np.int64),  # this many samples after the last,
        ("arrived_ns", np.int64),  # which arrived then
        ("heard_ns", np.int64),  # when it last sent a position
        ("greeted", np.int64),  # 1: its first position is known
        ("sends", np.int64),  # what is to be sent to it: nothing, a force, or the frame that disarms
        ("releases", np.int64),  # 1: another port ended, and its force ramps to zero,
        ("released", np.float64),  # samples of the ramp so far,
        ("ramp", np.float64),  # of this many,
        ("release_by_ns", np.int64),  # at the latest then
    ],
    align=True,
)
"""A port of a scene with several."""


@inlined
def publish_hands(port, loop, decoder):
    """Publishes the positions of the decoder's frame, which the clock of this port has gone on to."""
    io = loop.io
    for i in range(np.uint64(port.count)):
        point = port.points[i]
        if point.channel >= 0:
            counts = decoder.counts[point.channel] - io.origin_counts[point.channel]
            _publish(point, counts * io.position_scale[point.channel], port.clock.time_ns, port.gap)
            point.step *= loop.state.ticks > 1  # the first position may be that of a while ago


@inlined
def publish_masses(port, loop):
    """Publishes the next position of each mass, which the tick has moved."""
    program, ahead = program_at(loop.slot.program), port.clock.period_ns / loop.slot.substeps
    row = program.rows[np.uint64(program.turn)]
    for i in range(np.uint64(port.count)):
        point = port.points[i]
        if point.channel < 0:
            position = number_at(row, point.number, program.single)
            _publish(point, position, port.clock.time_ns + ahead, port.gap)


@inlined
def _publish(point, position, time_ns, gap):
    point.step = (position - point.position) / gap
    point.position, point.time_ns = position, time_ns


@inlined
def locate_points(ports, port, io):
    """Puts the points away where they are at the time of the port's clock."""
    for i in range(np.uint64(io.away_end - io.away_first)):
        other = ports[np.uint64(port.of_port[i])]
        point = other.points[np.uint64(port.of_point[i])]
        age = (port.clock.time_ns - point.time_ns) / other.clock.period_ns
        age = OLDEST if age > OLDEST else age if age > -1.0 else -1.0
        io.away[np.uint64(io.away_first) + i] = point.position + age * point.step
