"""The characteristic equation of the closed loop: linear in stiffness and damping (Florens et al., §6).

In kappa = K T²/m, beta = B T/m and w = z - 1, with the plant of ``sampled_plant.py`` and a damper's velocity v/y,

    (kappa + beta v/y) numerator(z) + z^lead (w² + p w + q) = 0,

cleared of fractions

    (kappa + beta offset) position(z) + beta w velocity(z) + (w² + p w + q) rest(z) = 0.

These are the paper's P, Q and R, apart from a common factor. Of a spring that acts ``lag`` samples later than the
damper, the backward difference takes kappa lag from beta.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from hapsim.theory.arrays import Floats
from hapsim.theory.hand.pole_pair import LinearOnPair, total
from hapsim.theory.hand.sampled_plant import SampledPlant
from hapsim.theory.interface import DamperModel


class LoopEquation(NamedTuple):
    """A plant behind a damper's readings. ``lift`` is the power of z by which fractions were cleared."""

    plant: SampledPlant
    damper: DamperModel
    lift: int
    lag: float

    @property
    def degree(self) -> int:
        """Number of poles."""
        return self.plant.lead + self.damper.delays + self.lift + len(self.damper.denominator) + 1


def loop_equation(plant: SampledPlant, damper: DamperModel, lag: float = 0.0) -> LoopEquation:
    """The equation of this plant and damper."""
    return LoopEquation(plant, damper, max(0, -plant.lead - damper.delays), lag)


def effective_stiffness(equation: LoopEquation, kappa: Floats, beta: Floats) -> Floats:
    """kappa + beta offset: stiffness, and what a sensor that reads at rest adds to it."""
    return kappa + equation.plant.offset * beta if equation.damper.senses else kappa


def characteristic(equation: LoopEquation, kappa: Floats, beta: Floats) -> list[Floats]:
    """The monic characteristic polynomial in z, highest power first, one array for each coefficient."""
    plant, beta = equation.plant, beta - equation.lag * kappa
    position, velocity, rest = _in_z(equation)
    free = np.convolve([1.0, plant.p - 2.0, 1.0 - plant.p + plant.q], rest)
    coefficients = [np.full_like(kappa, constant) for constant in free]
    effective = effective_stiffness(equation, kappa, beta)
    for polynomial, factor in ((position, effective), (np.convolve([1.0, -1.0], velocity), beta)):
        for j, constant in enumerate(polynomial[::-1], start=1):
            if constant != 0.0:
                coefficients[-j] += constant * factor
    return coefficients


def element_on_pair(equation: LoopEquation, w: LinearOnPair) -> tuple[LinearOnPair, LinearOnPair]:
    """(H, r) on a pair of poles: there the equation is kappa + beta w H + (w² + p w + q) r = 0."""
    plant, damper = equation.plant, equation.damper
    z = w.plus(1.0)
    numerator = z.polynomial(plant.numerator)
    if damper.senses:
        velocity = z.polynomial(plant.velocity).over(z.times(numerator))
    else:
        velocity = _in_w(damper.numerator, w).over(_in_w(damper.denominator, w).times(z.power(damper.delays)))
    if plant.lead < 0:
        return velocity, w.power(0).over(z.power(-plant.lead).times(numerator))
    return velocity, z.power(plant.lead).over(numerator)


def equation_on_pair(equation: LoopEquation, kappa: Floats, beta: Floats, w: LinearOnPair) -> LinearOnPair:
    """The characteristic polynomial on a pair w.

    Ordered by powers of w, so that what friction and simulated damping leave of each other is one sum,
    b0 T/m + beta, and not the difference of two polynomials.
    """
    plant, damper, beta = equation.plant, equation.damper, beta - equation.lag * kappa
    z = w.plus(1.0)
    _, velocity, rest = _in_z(equation)
    of_rest = z.power(plant.lead + damper.delays + equation.lift).times(_in_w(damper.denominator, w))
    of_position = z.polynomial(plant.numerator).times(z.power(damper.delays + equation.lift))
    square = w.times(w)
    terms = [
        of_position.times(_in_w(damper.denominator, w)).scaled(effective_stiffness(equation, kappa, beta)),
        w.scaled(velocity.sum() * (plant.damping + beta)),
        square.times(of_rest),
    ]
    if excess := _excess(plant, plant.p * rest.sum(), velocity.sum()):
        terms.append(w.scaled(excess))
    if plant.stiffness > 0.0:
        terms.append(of_rest.scaled(plant.q))
    for polynomial, factor in ((rest, plant.p), (velocity, beta)):
        if polynomial.size > 1:
            terms.append(square.times(z.polynomial(np.cumsum(polynomial)[:-1])).scaled(factor))
    return total(terms)


def _excess(plant: SampledPlant, swung: float, velocity_at_rest: float) -> float:
    """p rest(1) - b0 T/m velocity(1), which is nothing where a slow mass knows nothing of the sampling.

    A spring does, and a sensor that reads between two blows.
    """
    excess = swung - plant.damping * velocity_at_rest
    return excess if abs(excess) > 1e-14 * plant.p else 0.0


def _in_z(equation: LoopEquation) -> tuple[Floats, Floats, Floats]:
    """position, velocity and rest, each in powers of z, highest first."""
    plant, damper, lift, _ = equation
    denominator = np.append(_expanded(damper.denominator), np.zeros(damper.delays + lift))
    velocity = plant.velocity if damper.senses else np.convolve(plant.numerator, _expanded(damper.numerator))
    lead = plant.lead + damper.delays + lift
    rest = np.append(_expanded(damper.denominator), np.zeros(lead))
    return np.convolve(plant.numerator, denominator), np.append(velocity, np.zeros(lift)), rest


def _expanded(in_w: tuple[float, ...]) -> Floats:
    """A polynomial in w = z - 1, lowest power first, in powers of z, highest first."""
    in_z = np.zeros(1)
    for coefficient in reversed(in_w):
        in_z = np.convolve(in_z, [1.0, -1.0])
        in_z[-1] += coefficient
    return in_z[-len(in_w) :]


def _in_w(polynomial: tuple[float, ...], w: LinearOnPair) -> LinearOnPair:
    return w.polynomial(np.array(polynomial[::-1]))
