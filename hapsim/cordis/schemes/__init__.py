"""Schemes that move the masses from sample to sample. A new scheme is a file, a line here, and a word in
`hapsim/scene/choices.py`, the list of choices for a scene.

In every scheme the forces are those at sample n, computed from the positions at n: only then can the hand get them at
once. Schemes differ in the positions of the masses at n + 1.
"""

from __future__ import annotations

from hapsim.cordis.build_context import Scheme
from hapsim.cordis.schemes.exact import EXACT
from hapsim.cordis.schemes.midpoint import MIDPOINT
from hapsim.cordis.schemes.rk4 import RK4
from hapsim.cordis.schemes.semi_implicit import SEMI_IMPLICIT

CORDIS = Scheme(lambda _scene, context, present: tuple(one.build(context) for one in present))
"""CORDIS's own scheme: every type of module moves its points itself (`modules/points.py`, `modules/string.py`)."""

SCHEMES: dict[str, Scheme] = {
    "cordis": CORDIS,
    "semi_implicit": SEMI_IMPLICIT,
    "midpoint": MIDPOINT,
    "rk4": RK4,
    "exact": EXACT,
}


def without_matrices() -> list[str]:
    """Returns the schemes in which every live value of a scene can change while it runs."""
    return [name for name, scheme in SCHEMES.items() if scheme.inside is None]
