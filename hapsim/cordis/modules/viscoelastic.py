"""The visco-elastic link: a spring and a damper between two points (CORDIS: REF).

How far its ends part in a sample, g of `link.py`, the damper says: `damper_backward.py` and its kin, one a file, each
the recurrence of the transfer function that stands under the same name in `hapsim.theory`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

from hapsim.compiling import inlined
from hapsim.cordis.build_context import BuildContext
from hapsim.cordis.modules.link import Ends, ends_of, pull_ends
from hapsim.cordis.tick_state import Column
from hapsim.scene import Scene, ViscoElastic


class Links(NamedTuple):
    """L visco-elastic links: K in N/m, B/T in N/m; shape (L,)."""

    ends: Ends
    stiffness: Column
    damping_per_sample: Column


def with_damper(damper: str) -> Callable[[Scene], Mapping[str, ViscoElastic]]:
    """Selects the visco-elastic links of a scene that have this damper."""

    def select(scene: Scene) -> Mapping[str, ViscoElastic]:
        modules = scene.modules.items()
        return {name: one for name, one in modules if isinstance(one, ViscoElastic) and one.damper == damper}

    return select


def live_links(links: Sequence[ViscoElastic], rate: float) -> list[list[float]]:
    """K, and B/T, in N/m."""
    # The guard sees what comes of an infinity.
    return [[link.stiffness for link in links], [link.damping * rate for link in links]]


def links_of(links: Mapping[str, ViscoElastic], columns: Sequence[Column], context: BuildContext) -> Links:
    """What every damper's numbers begin with."""
    return Links(ends_of(links, context), *columns)


@inlined
def pull_link(links, i, d, growth, force):
    """Adds link i's force: stretched by `d`, by `growth` more than a sample before, in m."""
    pull_ends(links.ends, i, links.stiffness[i] * d + links.damping_per_sample[i] * growth, force)
