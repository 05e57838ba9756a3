"""Default travels, speeds and forces of hands and devices: one value for each motion.

A rotary channel has the mathematics of a line, in radians, but no metre is a radian. Where the size of a wheel would
say more, its rim is 0.2 m from the axis, as a steering wheel's: the fingers on a smaller one go less far. What follows
the declared mass needs no size: `scale_of` has it.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from hapsim.units import Motion


class Scale(NamedTuple):
    """Scales of one motion, in m, N, kg and s, or in rad, N·m, kg·m² and s."""

    credit: float = 0.25
    """At the force limit: the most energy that a scene can hold and a hand be credited with. Half of what the largest
    devices move; one turn, or the declared travel."""
    energy: float = 0.02
    """At the force limit: what a scene may give without having it, and what swings at the limit may. On the rim."""
    hand_force: float = 200.0
    """A hand pushes and pulls with less. On the rim."""
    hand_speed: float = 10.0
    """A hand or an obstacle may reverse this speed within a sample: twice 5 m/s; fingers turn a 1 cm shaft at 2 m/s."""
    sensor: float = 0.005
    """The error of a position sensor, beside its noise; 3 degrees, of a magnet beside its sensor's axis."""
    crossing: float = 0.1
    """A hand crosses a snap at this speed or faster: nobody rests in one that is narrower than its way in a sample."""
    kick: float = 0.1
    """The speed that a push of a measurement gives to what nothing holds: a fiftieth of a hand's 5 m/s or 60 rad/s."""
    travel: float = 0.005
    """Largest travel of a device that is identified or probed; 130 counts of 4096 a turn."""
    excited: float = 0.001
    """Travel during the excitation of an impedance; 33 such counts, whose rounding still is like noise."""
    rigid: float = 5e-4
    """The force limit stretches a device's own spring by more. On the rim."""
    brief: float = 1e-4
    """The force limit gives the energy limit within more than that. On the rim."""
    free: float = 1e-3
    """So far beyond an edge is a place where nothing holds a hand; twice that is drawn beside the edge. Below any
    device's travel."""
    grip_damping: float = 5.0
    """Damping of a light grip, with 0.5 kg and 300 N/m; a firm one has 20 N·s/m."""
    drag_stiffness: float = 200.0
    drag_damping: float = 2.0
    """Stiffness above, and damping, of the hand with which the page pulls the mock."""
    reach: float = 0.02
    """Reach of that hand to either side, at first."""
    jerk: float = 0.005
    """Visible motion of a free device. This and the next three are on the rim of a knob, 5 cm from its axis."""
    runaway: float = 0.1
    """Largest motion of a free device that late forces may cause."""
    grip: float = 0.002
    """Distance on a handle that makes another grip."""
    grip_force: float = 20.0
    """Largest force of a hand that moves a handle."""
    command_speed: float = 1.0
    """Largest speed of a commanded position, below that of a hand that stretches out; on the rim of such a knob."""
    command_acceleration: float = 100.0
    """Largest acceleration of a commanded position: ten times that of free fall. It then rests within 5 mm."""
    position_count: float = 1e-9
    """Count of the mock's position on the wire: 32 bits reach 2.1 m to either side, or 341 turns."""


SCALES: dict[Motion, Scale] = {
    "linear": Scale(),
    "rotary": Scale(
        credit=2.0 * math.pi,
        energy=0.1,
        hand_force=40.0,
        hand_speed=200.0,
        sensor=0.05,
        crossing=3.0,
        kick=1.0,
        travel=0.2,
        excited=0.05,
        rigid=2.5e-3,
        brief=5e-4,
        free=0.01,
        reach=0.5,
        jerk=0.1,
        runaway=2.0,
        grip=0.04,
        grip_force=1.0,
        command_speed=20.0,
        command_acceleration=2000.0,
        position_count=1e-6,
    ),
}


def scale_of(motion: Motion, mass: float, travel: float) -> Scale:
    """Returns the scales of a channel with this mass (kg, or kg·m²) and declared travel (m, or rad; infinite: none).

    What turns is credited with all of its travel. A hand holds it with 10/s and pulls it with 1000/s² of its inertia,
    however large it is: as 0.5 kg with 5 N·s/m, and 0.2 kg with 200 N/m.
    """
    own = SCALES[motion]
    if motion == "linear":
        return own
    credit = travel if travel < math.inf else own.credit
    return own._replace(credit=credit, grip_damping=10.0 * mass, drag_stiffness=1000.0 * mass, drag_damping=10.0 * mass)
