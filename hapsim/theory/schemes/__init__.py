"""What a scheme makes of a linear system from one sample to the next, one scheme a file, by the scene's names for them.

A system is M x'' + B x' + K x = 0 with M a vector of masses and symmetric B and K. Its state is (x, v), where x is in m
and v, in m/s, is what a link feels between two samples: of CORDIS's scheme (x[n] - x[n-1])/T, of the others their own.
"""

from __future__ import annotations

from hapsim.theory.schemes.centred import CORDIS, SEMI_IMPLICIT
from hapsim.theory.schemes.exact import EXACT
from hapsim.theory.schemes.midpoint import MIDPOINT
from hapsim.theory.schemes.rk4 import RK4
from hapsim.theory.schemes.scheme import LinkNature, SchemeModel, spectral_radius

SCHEMES: dict[str, SchemeModel] = {
    "cordis": CORDIS,
    "semi_implicit": SEMI_IMPLICIT,
    "midpoint": MIDPOINT,
    "rk4": RK4,
    "exact": EXACT,
}

__all__ = ["SCHEMES", "LinkNature", "SchemeModel", "spectral_radius"]
