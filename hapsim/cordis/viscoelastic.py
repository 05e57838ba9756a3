"""The visco-elastic link: a spring and a damper between two points (CORDIS: REF)."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

from hapsim.compiled import fused
from hapsim.cordis.kind import Column, Frame
from hapsim.cordis.link import Links, ends_of, pull_ends
from hapsim.scene import Scene, ViscoElastic


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


def links_of(links: Mapping[str, ViscoElastic], columns: Sequence[Column], frame: Frame) -> Links:
    """What every damper's part begins with."""
    return Links(ends_of(list(links.values()), frame, alike=True), *columns)


@fused
def pull_link(links, i, d, growth, force):
    """Adds link i's force: stretched by `d`, by `growth` more than a sample before, in m."""
    pull_ends(links.ends, i, links.stiffness[i] * d + links.damping_per_sample[i] * growth, force)
