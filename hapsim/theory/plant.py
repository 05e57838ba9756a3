"""Linear device that a hand holds: one mass, or a motor and a handle on a belt, with a motor whose force may lag.

Lengths in metres, times in sample periods, forces as T²/m f with m the mass of the whole. Any other linear device is
another ``Plant``.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from hapsim.theory.arrays import Complexes, Floats

POSITION, VELOCITY, LEAD, LEAD_RATE = range(4)


class Plant(NamedTuple):
    """Device of C channels, state' = ``rates`` state + ``force`` f + ``push`` p. The state (n,) begins with the C
    positions that are read and their C velocities; the others are its inner states."""

    rates: Floats
    """(n, n)."""
    force: Floats
    """(n, C): effect of the computed forces f, as the hold and the delay let them act."""
    push: Floats
    """(n, C): effect of the forces p of the hands, on the handles."""
    bodies: Floats
    """(P, n): positions of its masses, the handles last."""
    shares: Floats
    """(P,): their shares of the mass of their channel."""


def masses(damping: Floats, stiffness: Floats) -> Plant:
    """Returns C masses with friction T M^-1 b0 and own springs T² M^-1 k0, each (C, C)."""
    one, none = np.eye(len(damping)), np.zeros_like(damping)
    moved = np.vstack([none, one])
    return Plant(
        np.block([[none, one], [-stiffness, -damping]]), moved, moved, np.hstack([one, none]), np.ones(len(one))
    )


class Drive(NamedTuple):
    """Motor and belt of one channel; by default the force acts at once on one mass.

    Attributes:
        stiffness, damping: of the belt, N/m and N·s/m.
        motor_mass: kg of the whole mass m; the handle has the others. 0: there is no belt.
        reads_handle: the position that is read is the handle's, not the motor's.
        brakes_handle: the friction acts on the handle, not on the motor.
        lag: time constant with which the motor's force follows, s.
    """

    stiffness: float = 0.0
    damping: float = 0.0
    motor_mass: float = 0.0
    reads_handle: bool = False
    brakes_handle: bool = False
    lag: float = 0.0

    @property
    def is_elastic(self) -> bool:
        """True if motor and handle are two masses."""
        return self.motor_mass > 0.0

    @property
    def inner(self) -> int:
        """Number of inner states."""
        return 2 * self.is_elastic + (self.lag > 0.0)

    @property
    def compliance(self) -> float:
        """Way of the handle beyond its reading under a steady push, m/N."""
        return 0.0 if self.reads_handle or not self.is_elastic else 1.0 / self.stiffness

    def normalised(self, mass: float, rate: float) -> Drive:
        """Returns it in the units of a plant: k T²/m, b T/m, shares of the mass, and sample periods."""
        k, b = self.stiffness / (mass * rate) / rate, self.damping / (mass * rate)
        return self._replace(stiffness=k, damping=b, motor_mass=self.motor_mass / mass, lag=self.lag * rate)

    def plant(self, damping: float, stiffness: float) -> Plant:
        """Returns the plant of a normalised drive, with the friction b0 T/m, and the spring k0 T²/m on the handle. Its
        inner states are the lead of the side that is not read, the rate of this lead, and the lagged force."""
        size = 2 + self.inner
        x, v, *inner = np.eye(size)
        lagged, acting = np.zeros(size), np.zeros(size)
        if self.lag > 0.0:
            acting, lagged = inner[-1], inner[-1] / self.lag
        if not self.is_elastic:
            rates = [v, acting - stiffness * x - damping * v]
            moved, pushed, bodies, shares = v, v, [x], [1.0]
        else:
            d, e = inner[:2]
            shares = [self.motor_mass, 1.0 - self.motor_mass]
            motor, handle, of_motor, of_handle = x, x + d, v, v + e
            if self.reads_handle:
                motor, handle, of_motor, of_handle = handle, motor, of_handle, of_motor
            bodies = [motor, handle]
            pull = self.stiffness * (handle - motor) + self.damping * (of_handle - of_motor)
            braked = damping * (of_handle if self.brakes_handle else of_motor)
            at_motor = (pull + acting - (0.0 if self.brakes_handle else braked)) / shares[0]
            at_handle = (-pull - stiffness * handle - (braked if self.brakes_handle else 0.0)) / shares[1]
            read, other = (at_handle, at_motor) if self.reads_handle else (at_motor, at_handle)
            rates = [v, read, e, other - read]
            of_read, of_other = v - e, e  # an acceleration of the read side alone, and of the other
            moved, pushed = (of_other, of_read) if self.reads_handle else (of_read, of_other)
            moved, pushed = moved / shares[0], pushed / shares[1]
        if self.lag > 0.0:
            rates, moved = [*rates, -lagged], lagged
        return Plant(np.array(rates), moved[:, None], pushed[:, None], np.array(bodies), np.array(shares))


RIGID = Drive()


def answers(plant: Plant, s: Complexes) -> tuple[Complexes, Complexes]:
    """Positions (n, 2, 2C) at rates of growth s (n,), per sample period: read, and of the handles; after forces that
    act as exp(s t), and after pushes of the hands."""
    size, channels = plant.force.shape
    inputs = np.hstack([plant.force, plant.push])
    states = np.asarray(np.linalg.solve(s[:, None, None] * np.eye(size) - plant.rates, inputs + 0j), complex)
    return states[:, :channels], np.asarray(plant.bodies[-channels:] @ states)
