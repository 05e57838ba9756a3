"""The real mass as the computer sees it: G(z) = Y(z)/f(z), by the modified z-transform.

Time in sample periods, force as T²/m f. With w = z - 1, A = 1 - exp(-b0 T/m), delay = D + fraction:

    1/G(z) = z^(order - 1) w (w + A) / numerator(z),   order = D + degree of the numerator

The loop closed by the visco-elastic element K + B (1 - 1/z)/T has then, with kappa = K T²/m and
beta = B T/m, the characteristic equation (Florens et al., §6)

    (kappa z + beta w) numerator(z) + z^order w (w + A) = 0
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from hapsim.theory.arrays import Floats
from hapsim.theory.interface import HOLDS, SAMPLINGS, whole_and_fraction
from hapsim.theory.phi import phi
from hapsim.theory.shape import Term, product


class Plant(NamedTuple):
    """``damping`` is b0 T/m, ``decay`` is A; ``numerator`` in powers of z, highest first, all positive."""

    damping: float
    decay: float
    numerator: Floats
    order: int


def sampled_plant(damping: float, delay: float, hold: str, sampling: str) -> Plant:
    """The plant of a normalised real friction b0 T/m and a delay in sample periods."""
    whole, fraction = whole_and_fraction(delay)
    terms = product(HOLDS[hold].terms, SAMPLINGS[sampling].terms)
    count = max(term.lag for term in terms) + (1 if fraction == 0.0 else 2)
    response = _force_response(terms, damping, np.arange(1.0, count + 1.0) - fraction)

    # Once the hold and the sampling are over, the response is a constant and an exponential: the denominator
    # below annihilates it, and what is left of the product is the numerator.
    denominator = np.array([1.0, -1.0 - np.exp(-damping), np.exp(-damping)])
    numerator = np.convolve(response, denominator)[:count]
    return Plant(damping, -float(np.expm1(-damping)), numerator, whole + count - 1)


def _force_response(terms: tuple[Term, ...], damping: float, times: Floats) -> Floats:
    """What the computer reads, ``times`` sample periods after one computed force came, into rest."""
    response = np.zeros_like(times)
    for weight, lag, integrations in terms:
        since = np.maximum(times - lag, 0.0)
        power = integrations + 1
        response += weight * since**power * phi(power, damping * since)
    return response
