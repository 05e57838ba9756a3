"""Linear scene as arrays: device channels, CORDIS masses and visco-elastic links."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hapsim.dampers import DamperModel
from hapsim.holds import HOLDS
from hapsim.theory.arrays import Bools, Floats, Indices, link_ends, matrix, not_negative, one_of, positive, vector
from hapsim.theory.follower import Follower
from hapsim.theory.interface import SAMPLINGS, Ahead, BoardLaw, Clocks, StatePredictor, damper_named
from hapsim.theory.plant import Drive
from hapsim.theory.schemes import SCHEMES, LinkNature

BACKWARD = damper_named("backward", None, 1.0)
DECIMATIONS = ("last", "mean")
EVERY = slice(None)
_SAME_MASS = 1e-9
_TAKES_NO = {
    "mass_coupling": ("ahead", "predictors"),
    "drives": ("mass_coupling", "ahead", "predictors"),
    "board": ("mass_coupling", "rows", "second", "drives", "ahead", "predictors"),
    "followers": ("mass_coupling", "drives", "ahead", "predictors", "board"),
    "clocks": ("ahead", "predictors", "board", "followers"),
}


@dataclass(frozen=True, eq=False)
class Network:
    """Device channels, masses and links that run together at one rate.

    Points are numbered: 0 to C - 1 the device channels, C to C + M - 1 the simulated masses, -1 a ground. CORDIS's
    scheme moves a simulated mass by m/T² (x[n+1] - 2 x[n] + x[n-1]) = F[n]; for the others see ``theory/schemes.py``. A
    link's force on its first end is -K (xa - xb)[n] - (B/T) (va - vb)[n], the opposite on its second; its damper
    computes v, in metres per sample period, from x (``DamperModel``). A channel's x[n] is its measured sample; the sum
    of its links' forces acts on its real mass from (n + delay) T on, by the hold. The mass itself moves in continuous
    time, exactly: m x'' + b0 x' + k0 x = F (Florens et al., §6 and Figure 5).

    At an end that is a channel, a damper that senses uses the velocity that the device reads. With ideal sampling it is
    the real one at the instant of the sample, before any change of the force at that instant; with averaged sampling
    its mean over the last period.

    An implicit mass moves by m/T² (x[n] - 2 x[n-1] + x[n-2]) = F[n], with F[n] at this same x[n]. No link joins two of
    them, and dampers there are backward.

    In the plane a point is the x or the y of something that moves, and a link is one ``rows`` or several in place of
    ``ends``. With d the stretch of a row, its tension is K d[n] + (B/T) v[n], and the points are pulled by -``pulls``
    times it. The two differ where a motion along a surface changes the force across it, as friction does.

    Attributes:
        rate: sample rate, Hz, > 0.
        channel_mass: (C,) real masses, kg, > 0. Given as a symmetric positive definite matrix (C, C), it is the
            diagonal, and ``mass_coupling`` has the rest.
        channel_friction: (C,) real viscous frictions b0, N·s/m, >= 0.
        delay: sample periods from the sampling of a position to the change of the force that answers it, >= 0.
        hold: name in HOLDS. sampling: "ideal" or "average". As for ``Configuration``.
        point_mass: (M,) simulated masses, kg, > 0.
        ends: (L, 2) the two points that each link joins; empty with ``rows``.
        stiffness: (L,) K in N/m.
        damping: (L,) B in N·s/m.
        channel_stiffness: (C,) real springs k0 from the channels' masses to x = 0, N/m, >= 0. Default: none.
        damper: (L,) damper of each link, from ``interface.damper_named``. Default: all backward.
        margin_links: number of links, from the first on, whose margins are computed. Default: all.
        scheme: integration scheme of the masses, one of ``theory.schemes``.
        outside: (L,) links whose force a scheme always takes at the sample (``theory/schemes.py``). Default: none.
        substeps: N, steps of the masses in a sample period (``theory/sample.py``); for the masses and for ``damper``, T
            and n are then those of a step.
        decimation: force on a channel: that of the "last" step, or the "mean" of all N.
        ahead: the links see the channels ahead of their readings, as of a device that senses velocity and acceleration;
            None: at their readings.
        implicit: (M,) masses with an implicit step, under CORDIS's scheme without substeps. Default: none.
        second: (L, 2) weights of each link's second end: in its stretch, and in its pull on it; not with ``rows`` and
            ``board``. Default: 1.
        rows: (L, C + M) stretch of each row from the points' positions, in place of ``ends``. Default: none.
        pulls: (L, C + M) direction in which the tension of each row pulls the points. Default: ``rows``.
        link_of_row: (L,) number of the link that a row belongs to, for margins: they scale all rows of a link together.
            Default: each row is a link.
        mass_coupling: (C, C) real masses beside the diagonal, kg; not with ``ahead`` or ``predictors``. Default: none.
        predictors: (C,) the links see the channels as these predict them (``theory/observer.py``). Default: none.
        drives: (C,) motor and belt of each channel (``theory/plant.py``); own springs and hands are then at the handle,
            and ``channel_mass`` is that of the whole; not with ``ahead``, ``predictors`` or a mass matrix. Default:
            every force acts at once on one mass.
        board: the board moves each force along a line between two samples (``board_lines.py``); behind a zero-order
            hold, ideal sampling and whole local periods of delay, with backward dampers at the channels, and without
            ``ahead``, ``predictors``, ``drives``, ``rows`` and a mass matrix. Default: the device holds it.
        followers: (C,) the channels are simulated masses, whose positions the device follows (``follower.py``);
            their frictions and own springs are those of mass and hand together, and links act on them at once; behind a
            zero-order hold and ideal sampling, and without anything else that changes how a force moves a channel.
            Default: every force acts on a real mass.
        clocks: the channels are those of several ports, each with its own clock, delay, hold, sampling and decimation
            in place of those above (``several_clocks.py``); without ``ahead``, ``predictors``, ``board``, ``followers``
            and masses that join two ports; no link between two ports senses or ends on an implicit mass. Default: one
            clock.

    Raises:
        ValueError: an argument is out of its range or its shape does not fit; the message states which.
    """

    rate: float
    channel_mass: Floats
    channel_friction: Floats
    delay: float
    hold: str
    sampling: str
    point_mass: Floats
    ends: NDArray[np.intp]
    stiffness: Floats
    damping: Floats
    channel_stiffness: Floats = ()  # type: ignore[assignment]
    damper: Sequence[DamperModel] = ()
    margin_links: int | None = None
    scheme: str = "cordis"
    outside: Sequence[bool] = ()
    substeps: int = 1
    decimation: str = "last"
    ahead: Ahead | None = None
    implicit: Bools = ()  # type: ignore[assignment]
    second: Floats | None = None
    rows: Floats | None = None
    pulls: Floats | None = None
    link_of_row: Indices = ()  # type: ignore[assignment]
    mass_coupling: Floats | None = None
    predictors: Sequence[StatePredictor] = ()
    drives: Sequence[Drive] = ()
    board: BoardLaw | None = None
    followers: Sequence[Follower] = ()
    clocks: Clocks | None = None

    def __post_init__(self) -> None:
        mass, coupling = _masses(self.channel_mass, self.mass_coupling)
        point_mass = vector("point_mass", self.point_mass, above=0.0)
        ends = link_ends("ends", self.ends, mass.size + point_mass.size)
        rows, pulls = self._checked_rows(mass.size + point_mass.size)
        links = len(ends) if rows is None else len(rows)
        own = np.zeros(mass.size) if len(self.channel_stiffness) == 0 else self.channel_stiffness
        checked: dict[str, Any] = {
            "rate": positive("rate", self.rate),
            "channel_mass": mass,
            "channel_friction": vector("channel_friction", self.channel_friction, mass.size, least=0.0),
            "delay": not_negative("delay", self.delay),
            "hold": one_of("hold", self.hold, HOLDS),
            "sampling": one_of("sampling", self.sampling, SAMPLINGS),
            "point_mass": point_mass,
            "ends": ends,
            "stiffness": vector("stiffness", self.stiffness, links),
            "damping": vector("damping", self.damping, links),
            "channel_stiffness": vector("channel_stiffness", own, mass.size, least=0.0),
            "damper": tuple(self.damper) or (BACKWARD,) * links,
            "scheme": one_of("scheme", self.scheme, SCHEMES),
            "outside": tuple(self.outside),
            "substeps": int(positive("substeps", self.substeps)),
            "decimation": one_of("decimation", self.decimation, DECIMATIONS),
            "implicit": np.array(self.implicit, bool) if len(self.implicit) else point_mass < 0.0,
            "second": self._checked_second(links),
            "rows": rows,
            "pulls": pulls,
            "link_of_row": np.array(self.link_of_row, np.intp),
            "mass_coupling": coupling,
        }
        for name in ("damper", "outside", "link_of_row"):
            if len(checked[name]) not in {0, links}:
                raise ValueError(f"{name} has {len(checked[name])} elements, but there are {links} links.")
        for name in ("predictors", "drives", "followers"):
            if len(given := getattr(self, name)) not in {0, mass.size}:
                raise ValueError(f"{name} has {len(given)} elements, but there are {mass.size} channels.")
        self._check_together(coupling)
        if any(not 0.0 <= one.motor_mass < own for one, own in zip(self.drives, mass.tolist(), strict=False)):
            raise ValueError("a motor has to be lighter than motor and handle together.")
        self._check_clocks(coupling, mass.size + point_mass.size)
        if checked["implicit"].any():
            if rows is not None:
                raise ValueError("implicit masses take ends, not rows.")
            at = np.concatenate([mass < 0.0, checked["implicit"], [False]])[ends]  # the last is a ground
            backward = np.array([one == BACKWARD for one in checked["damper"]], bool)
            if (at.sum(axis=1) > backward).any() or (self.scheme, self.substeps) != ("cordis", 1):
                raise ValueError("implicit masses take no link between two, backward dampers alone, no other scheme.")
        for name, value in checked.items():
            object.__setattr__(self, name, value)

    def _check_together(self, coupling: Floats | None) -> None:
        """Raises ValueError if one thing is given with another that it is not derived with."""
        names = ("rows", "second", "ahead", "predictors", "drives", "board", "followers", "clocks")
        given = {name: getattr(self, name) for name in names} | {"mass_coupling": coupling}
        known = [name for name, one in given.items() if one is not None and len(one)]
        for name, others in _TAKES_NO.items():
            for other in (other for other in others if name in known and other in known):
                raise ValueError(f"{name} takes no {other}.")
        for name in {"board", "followers"} & {*known}:
            if (self.hold, self.sampling) != ("zoh", "ideal"):
                raise ValueError(f"{name} needs a zoh hold and ideal sampling.")
        if self.board is not None:
            periods = self.delay * self.board.steps
            if self.decimation != "last" or abs(periods - round(periods)) > _SAME_MASS * periods:
                raise ValueError("board needs the force of the last step, and whole local periods of delay.")

    def _checked_second(self, links: int) -> Floats | None:
        """Returns ``second``; None where the second ends have no weights."""
        if self.second is None:
            return None
        second = matrix("second", self.second, 2)
        if self.rows is not None or len(second) != links:
            raise ValueError(f"second has {len(second)} rows, but there are {links} links with two ends.")
        return second

    def _check_clocks(self, coupling: Floats | None, points: int) -> None:
        """Raises ValueError if something needs one clock for several ports, or the ports do not fit the points."""
        if (clocks := self.clocks) is None:
            return
        ports, count = np.array(clocks.port, np.intp), len(clocks.interfaces)
        if ports.size != points or not {*clocks.port} <= {*range(count)}:
            raise ValueError(f"clocks need a port from 0 to {count - 1} for each channel and each mass.")
        if coupling is not None and bool((coupling * (ports[: len(coupling), None] != ports[: len(coupling)])).any()):
            raise ValueError("clocks take no mass matrix that joins channels of two ports.")
        if len(clocks.phases) not in {0, count}:
            raise ValueError(f"clocks have {len(clocks.phases)} phases, but there are {count} ports.")

    def _checked_rows(self, points: int) -> tuple[Floats | None, Floats | None]:
        """Returns ``rows`` and ``pulls``; both are None where links have ends."""
        if self.rows is None:
            if self.pulls is not None or len(self.link_of_row):
                raise ValueError("pulls and link_of_row need rows.")
            return None, None
        if len(self.ends):
            raise ValueError("a network has ends or rows, not both.")
        rows = matrix("rows", self.rows, points)
        pulls = rows if self.pulls is None else matrix("pulls", self.pulls, points)
        if len(pulls) != len(rows):
            raise ValueError(f"pulls has {len(pulls)} rows, but it has to have {len(rows)}, as rows has.")
        return rows, pulls

    @property
    def mass_matrix(self) -> Floats:
        """Real masses, (C, C), kg."""
        return np.diag(self.channel_mass) + (0.0 if self.mass_coupling is None else self.mass_coupling)


def _masses(given: Any, coupling: Any) -> tuple[Floats, Floats | None]:
    """Returns the diagonal (C,) of the channels' masses, and the matrix (C, C) of the others; None if they are 0."""
    if np.ndim(given) == 2:
        whole = matrix("channel_mass", given, len(given))
        given = whole.diagonal()
        coupling = whole - np.diag(given) if len(given) == len(whole) else None
    mass = vector("channel_mass", given, above=0.0)
    if coupling is None or not np.any(coupling):
        return mass, None
    coupling = matrix("mass_coupling", coupling, mass.size)
    whole = np.diag(mass) + coupling
    if len(coupling) != mass.size or coupling.diagonal().any() or not (coupling == coupling.T).all():
        raise ValueError("the masses of coupled channels have to be a symmetric matrix.")
    if np.linalg.eigvalsh(whole)[0] <= 0.0:
        raise ValueError("the masses of coupled channels have to be a positive definite matrix.")
    return mass, coupling


def is_centred(network: Network) -> bool:
    """Returns whether all points move once a sample, and the masses, if any, by CORDIS's scheme, none implicitly; a
    link then changes the loop by a matrix of rank one."""
    is_cordis = SCHEMES[network.scheme] is None or network.point_mass.size == 0
    own = network.board is None and network.clocks is None
    return network.substeps == 1 and is_cordis and not network.implicit.any() and own


def acting_links(network: Network) -> Indices:
    """Links that join two different points, or a point and a ground; of rows, those that stretch and pull."""
    if network.rows is not None and network.pulls is not None:
        return np.flatnonzero(network.rows.any(axis=1) & network.pulls.any(axis=1))
    return np.flatnonzero(network.ends[:, 0] != network.ends[:, 1])


def damping_links(network: Network) -> Indices:
    """Acting links with a damping."""
    links = acting_links(network)
    return links[network.damping[links] != 0.0]


def margin_links(network: Network) -> Indices:
    """Acting links whose margins are wanted, by the scene's numbers."""
    links = np.unique(links_of_rows(network)[acting_links(network)])
    return links if network.margin_links is None else links[links < network.margin_links]


def links_of_rows(network: Network) -> Indices:
    """Number of the link that each row belongs to, (L,); without rows a link's own number."""
    return network.link_of_row if network.link_of_row.size else np.arange(network.stiffness.size)


def rows_of(network: Network, link: int) -> Indices:
    """Rows of a link."""
    return np.flatnonzero(network.link_of_row == link) if network.link_of_row.size else np.array([link])


def link_count(network: Network) -> int:
    """Number of links, with those that have no row now."""
    if network.rows is None:
        return len(network.ends)
    return max(int(links_of_rows(network).max(initial=-1)) + 1, network.margin_links or 0)


def inner_links(network: Network) -> Indices:
    """Acting links whose forces the scheme computes between two samples; none for CORDIS's scheme."""
    scheme = SCHEMES[network.scheme]
    if scheme is None or is_centred(network):
        return np.zeros(0, np.intp)
    links = np.setdiff1d(acting_links(network), np.flatnonzero(network.outside))
    at_channel = touches_channel(network, links)
    natures = (_nature(network.damper[link], at) for link, at in zip(links.tolist(), at_channel.tolist(), strict=True))
    return links[np.fromiter(map(scheme.inside, natures), bool, links.size)]


def touches_channel(network: Network, links: Indices) -> Bools:
    """Flags (n,): which of these links end at a channel."""
    place, point = joined_points(network, links)
    return np.bincount(place[point < network.channel_mass.size], minlength=links.size) > 0


def joined_points(network: Network, links: Indices | Bools | slice = EVERY) -> tuple[Indices, Indices]:
    """Pairs (place among ``links``, point), for each point that one of these links joins, by links."""
    if network.rows is not None and network.pulls is not None:
        place, point = np.nonzero((network.rows[links] != 0.0) | (network.pulls[links] != 0.0))
        return place, point
    ends = network.ends[links]
    place, end = np.nonzero(ends >= 0)
    return place, ends[place, end]


@lru_cache(64)
def _nature(damper: DamperModel, at_channel: bool) -> LinkNature:
    return LinkNature(damper == BACKWARD, is_memoryless(damper), at_channel)


def is_memoryless(damper: DamperModel) -> bool:
    """Returns whether the damper's velocity depends on the newest two positions alone, or is sensed."""
    return len(damper.of_positions) <= 2 and not damper.of_velocities


def parts_of(network: Network, links: Indices | Bools | slice = EVERY, also: Sequence[Sequence[int]] = ()) -> Indices:
    """Part of each point (C + M,): equal numbers for points that these links join, or a mass matrix. ``also``: pairs of
    points that count as joined, such as the x and the y of a hand."""
    place, point = joined_points(network, links)
    pairs = np.column_stack([point[:-1], point[1:]])[place[1:] == place[:-1]]
    masses = np.zeros((0, 2), np.intp) if network.mass_coupling is None else np.argwhere(network.mass_coupling)
    whole = np.concatenate([pairs, masses, np.array(also, np.intp).reshape(-1, 2)])
    return part_of_each(whole, network.channel_mass.size + network.point_mass.size)


def part_of_each(ends: Indices, points: int) -> Indices:
    """Part of each point (points,): equal numbers for points joined by links, (L, 2) ends. A ground (-1) joins none."""
    parent = list(range(points))

    def part(point: int) -> int:
        """Returns the first point of its part, and shortens the way to it."""
        while parent[point] != point:
            parent[point] = parent[parent[point]]
            point = parent[point]
        return point

    for a, b in ends[(ends >= 0).all(axis=1)].tolist():
        parent[part(a)] = part(b)
    return np.array([part(point) for point in range(points)], dtype=np.intp)


def part_of(network: Network, points: Indices, linked: bool = True) -> Network:
    """Returns the network of these points, ascending, and of the links that join no other point; ``linked`` False:
    without links."""
    number = np.full(network.channel_mass.size + network.point_mass.size + 1, -2)
    number[points], number[-1] = np.arange(points.size), -1
    place, point = joined_points(network)
    links = np.setdiff1d(place, place[number[point] == -2]) if linked else place[:0]
    return picked(
        network, points, int((points < network.channel_mass.size).sum()), links, **_clocks_of(network, points)
    )


def picked(network: Network, points: Indices, hands: int, links: Indices, **changed: Any) -> Network:
    """Returns the network of these points and links, changed. The first ``hands`` of the points are channels; those
    that are masses in ``network`` have any mass."""
    number = np.full(network.channel_mass.size + network.point_mass.size + 1, -2)
    number[points], number[-1] = np.arange(points.size), -1
    channels, masses = points[:hands], points[hands:] - network.channel_mass.size
    rows, pulls, coupling, more = network.rows, network.pulls, network.mass_coupling, (0, network.point_mass.size)
    of_channels = ("channel_mass", "channel_friction", "channel_stiffness")
    of_each = {name: getattr(network, name) for name in ("drives", "predictors", "followers")}
    picks: dict[str, Any] = {
        **{name: np.pad(getattr(network, name), more, constant_values=1.0)[channels] for name in of_channels},
        **{name: [of[channel] for channel in channels.tolist() if channel < len(of)] for name, of in of_each.items()},
        "point_mass": network.point_mass[masses],
        "implicit": network.implicit[masses],
        "ends": number[network.ends[links]] if rows is None else network.ends,
        "second": None if network.second is None else network.second[links],
        "rows": None if rows is None else rows[np.ix_(links, points)],
        "pulls": None if pulls is None else pulls[np.ix_(links, points)],
        "link_of_row": network.link_of_row if rows is None else links_of_rows(network)[links],
        "mass_coupling": None if coupling is None else np.pad(coupling, more)[np.ix_(channels, channels)],
        "stiffness": network.stiffness[links],
        "damping": network.damping[links],
        "damper": tuple(network.damper[link] for link in links.tolist()),
        "outside": tuple(network.outside[link] for link in links.tolist()) if network.outside else (),
        "margin_links": None,
    }
    return replace(network, **picks | changed)


def _clocks_of(network: Network, points: Indices) -> dict[str, Any]:
    """Returns the keys of the clocks of these points; of points on one port, those of its interface."""
    if (clocks := network.clocks) is None:
        return {}
    port = tuple(np.array(clocks.port, np.intp)[points].tolist())
    if len({*port}) == 1:
        return clocks.interfaces[port[0]]._asdict() | {"clocks": None}
    return {"clocks": clocks._replace(port=port)}


def without_observers(network: Network) -> Network | None:
    """Returns the network that masses see whose predictors assume them: no delay. Its motions are those of the network,
    apart from the observers' own, which nothing else moves. None if a predictor assumes another mass."""
    assumed = [one.mass for one in network.predictors]
    if not np.allclose(assumed, network.channel_mass[: len(assumed)], rtol=_SAME_MASS, atol=0.0):
        return None
    return replace(network, predictors=(), delay=0.0, sampling="ideal") if assumed else network


def kinetic_energy(network: Network, velocities: NDArray) -> Floats:
    """Kinetic energy (C + M, n) of each point, in any unit, at these velocities (C + M, n). That of coupled masses M is
    divided by the parts of M^1/2 v, of which none is negative."""
    mass = np.concatenate([network.channel_mass, network.point_mass])
    energy = mass[:, None] * np.abs(velocities) ** 2
    if network.mass_coupling is not None:
        values, vectors = np.linalg.eigh(network.mass_matrix)
        root, hands = vectors * np.sqrt(values) @ vectors.T, len(values)
        energy[:hands] = np.abs(root @ velocities[:hands]) ** 2
    return np.asarray(energy)


def proves_stability(network: Network) -> bool:
    """Returns True if a simple test proves that no motion grows; False if it proves nothing. It applies to masses
    without a channel, under CORDIS's scheme, on springs and backward dampers that are not negative, nor too stiff for
    the step T.

    For a motion v, the poles solve z² m + z (k T² + b T - 2 m) + m - b T = 0, with real m = v* M v and so on. No root
    is outside the unit circle if k, b >= 0 and 4 m >= k T² + 2 b T (Jury). Every v satisfies this if the sum of each
    row's absolute values does (Gershgorin).
    """
    has_rows = network.rows is not None or network.second is not None
    if has_rows or network.channel_mass.size or SCHEMES[network.scheme] is not None or network.implicit.any():
        return False
    links, dampers = acting_links(network), (network.damper[link] for link in damping_links(network).tolist())
    stiffness, damping, ends = network.stiffness[links], network.damping[links], network.ends[links]
    if (stiffness < 0.0).any() or (damping < 0.0).any() or any(damper != BACKWARD for damper in dampers):
        return False
    step = 1.0 / (network.rate * network.substeps)
    of_link = (stiffness * step + 2.0 * damping) * step * (ends >= 0).sum(axis=1)
    held = sum(np.bincount(end[end >= 0], of_link[end >= 0], network.point_mass.size) for end in ends.T)
    return bool((held <= 4.0 * network.point_mass).all())
