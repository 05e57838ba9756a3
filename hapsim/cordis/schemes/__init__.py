"""What moves the masses from sample to sample. A new scheme is a file and a line here, and a word in the scene's own
list, `hapsim/scene/choices.py`, which says which of them are offered.

Forces are those at sample n, worked out from the positions at n, whatever the scheme: only then can the hand have them
at once. What differs is where the masses are at n + 1.
"""

from __future__ import annotations

from hapsim.cordis.build_context import Scheme
from hapsim.cordis.schemes.exact import EXACT
from hapsim.cordis.schemes.midpoint import MIDPOINT
from hapsim.cordis.schemes.rk4 import RK4
from hapsim.cordis.schemes.semi_implicit import SEMI_IMPLICIT

CORDIS = Scheme(lambda _scene, context, present: tuple(one.build(context) for one in present))
"""CORDIS's own: every type of module moves its points itself (`modules/points.py`, `modules/string.py`)."""

SCHEMES: dict[str, Scheme] = {
    "cordis": CORDIS,
    "semi_implicit": SEMI_IMPLICIT,
    "midpoint": MIDPOINT,
    "rk4": RK4,
    "exact": EXACT,
}


def without_matrices() -> list[str]:
    """The schemes under which every live value of a scene can change while it runs."""
    return [name for name, scheme in SCHEMES.items() if scheme.inside is None]
