"""A string as a Faust program over mi.lib, in the form that mi.lib's own scripting tool writes.

mi.lib takes its parameters per sample: what it adds to a position each sample is force / mass. So the mass is m/T², and
K d + (B/T) (d - d-) stays a force in N.
"""

from __future__ import annotations

from enum import Enum

from hapsim.speed_accuracy.strings import StringOfMasses, hand_link, held_mass


class Drive(Enum):
    """Inputs and outputs of the program."""

    HAND = "a hand's position in, the force on it out"
    ONE = "a force on one mass in, the position of that mass out"
    ALL = "a force on each mass in, the position of each out"


def program_of(string: StringOfMasses, drive: Drive) -> str:
    """The text. Forces in N, positions in m; the rate is known to it when it starts."""
    masses, links = string.masses, string.masses + 1
    hand = drive is Drive.HAND
    stiffness, damping = hand_link(string)
    points = ["mi.ground(0)", *["mi.mass(M, 0, 0, 0)"] * masses, "mi.ground(0)"]
    pulls = ["mi.springDamper(K, Z, 0, 0)"] * links
    if hand:
        points.append("mi.posInput(0)")
        pulls.append("mi.springDamper(HandK, HandZ, 0, 0)")
    outputs = {Drive.HAND: 0, Drive.ONE: 1, Drive.ALL: masses}[drive]
    forces = 2 * len(pulls)
    kept = _kept(forces, hand)
    return f"""import("stdfaust.lib");
M = {string.mass!r} * ma.SR * ma.SR;
K = {string.stiffness!r};
Z = {string.damping!r} * ma.SR;
HandK = {stiffness!r};
HandZ = {damping!r} * ma.SR;
process = (ToPoints : {_parallel(points)}{_more(outputs)} : ToLinks : {_parallel(pulls)}{_more(outputs)})
    ~ par(i, {forces}, _) : {kept}{_more(outputs)}
with {{
    {_to_points(string, drive)};
    {_to_links(string, drive)};
}};
"""


def _to_points(string: StringOfMasses, drive: Drive) -> str:
    """The links' forces and what comes in -> what each point takes; then once more what has to come out.

    A mass's position is not known here yet: where it comes out, a 0 keeps its place.
    """
    masses, links = string.masses, string.masses + 1
    first, second = [f"a{i}" for i in range(links)], [f"b{i}" for i in range(links)]
    taken = [[first[0]], *([second[i], first[i + 1]] for i in range(masses)), [second[-1]]]
    pairs = [name for pair in zip(first, second, strict=True) for name in pair]
    inputs = {Drive.HAND: ["hand"], Drive.ONE: ["push"], Drive.ALL: [f"p{i}" for i in range(masses)]}[drive]
    at = held_mass(string) + 1
    if drive is Drive.HAND:
        pairs += ["handA", "handB"]
        taken[at].append("handB")
        taken += [["handA"], ["hand"]]
    elif drive is Drive.ONE:
        taken[at].append("push")
    else:
        for i in range(masses):
            taken[i + 1].append(f"p{i}")
    zeros = {Drive.HAND: 0, Drive.ONE: 1, Drive.ALL: masses}[drive]
    results = [" + ".join(names) for names in taken] + ["0"] * zeros
    return f"ToPoints({', '.join(pairs + inputs)}) = {', '.join(results)}"


def _to_links(string: StringOfMasses, drive: Drive) -> str:
    """The points' positions -> what each link takes; then those that have to come out."""
    masses, links = string.masses, string.masses + 1
    points = [f"x{i}" for i in range(masses + 2)]
    taken = [name for i in range(links) for name in (points[i], points[i + 1])]
    at = held_mass(string) + 1
    given = list(points)
    if drive is Drive.HAND:
        given.append("hand")
        taken += ["hand", points[at]]
    elif drive is Drive.ONE:
        given.append("place")
        taken.append(points[at])
    else:
        given += [f"place{i}" for i in range(masses)]
        taken += points[1:-1]
    return f"ToLinks({', '.join(given)}) = {', '.join(taken)}"


def _kept(forces: int, hand: bool) -> str:
    """Selects the output: with a hand only the force on it, at the first end of the last link."""
    return f"par(i, {forces - 2}, !), _, !" if hand else f"par(i, {forces}, !)"


def _parallel(parts: list[str]) -> str:
    return ", ".join(parts)


def _more(wires: int) -> str:
    return f", par(i, {wires}, _)" if wires else ""
