"""The law of a scene's force in a record: what it makes of the positions, linear or not."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hapsim.loop.ring import BRIDGED, LATE_FORCE
from hapsim.measuring.converters import Complexes, Floats
from hapsim.measuring.trace_quality import is_always_late
from hapsim.recording.trace import Trace

_LAWFUL, _EXACT = 1e-9, 1e-11  # of the largest force: the largest error of one that obeys a law; with a memory, which
# fits a slightly curved law, too
_NO_SPRING = 1e-6  # of the largest force
_MEMORY, _MEMORIES = 4, range(2, 8)  # samples: of filters and sensors; of predictors too, by the delay
_LITTLE = 0.01  # modulus: a smaller pole of the force is over before the first row of a fit
_CERTAIN = 0.02  # counts: a rest with this uncertainty counts as exact


class Law(NamedTuple):
    """The scene's force as a linear function of positions, of earlier positions and forces."""

    memory: int
    obeyed: bool
    stands: bool  # True if it depends on no position
    rest: float  # the position of zero force, counts
    uncertainty: float
    poles: Complexes
    """Poles of the force by itself: of a predictor, filters, masses. Those outside of the unit circle are mirrored: of
    noise that passes them, the spectrum is the same."""


def asks_by_one_law(trace: Trace, channel: int) -> bool:
    """Returns True if the scene's force was always linear in the positions, with little memory: no link touched,
    released or slid."""
    asked, counts = trace.asked_force[:, channel], trace.position_counts[:, channel].astype(float)
    surplus = trace.force_counts[:, channel] * trace.force_scale[channel] - asked
    law = shortest_law(counts - np.median(counts), asked, surplus, following(trace))
    return law is None or (law.obeyed and law.memory <= _MEMORY)


def following(trace: Trace) -> NDArray[np.bool_]:
    """Returns for each row but the first if it follows the one before without a gap, and the force sent then acted."""
    spoilt = BRIDGED | (0 if is_always_late(trace) else LATE_FORCE)
    return np.asarray((np.diff(trace.sample) == 1) & (trace.flags[1:] & spoilt == 0))


def rest_by(position: Floats, law: Law | None, pressed: bool) -> tuple[float, bool, bool]:
    """Returns the rest position, in counts; whether it is certain; whether the scene has no spring.

    At rest the scene's force is zero. With springs and dampers to the ground that force is linear in the positions and
    their past. If the record obeys such a law, its constant gives the rest; else, as in a scene with masses, or if a
    constant force presses the hand, the middle of the motion is returned.
    """
    if law is None and not pressed:
        return 0.0, True, False
    if law is not None and not pressed:
        if law.memory == 1 and law.obeyed:
            return law.rest, True, law.stands
        if law.memory > 1 and not law.stands and (law.obeyed or law.uncertainty < _CERTAIN):
            return law.rest, True, False
    return float(np.median(position)), False, False


def shortest_law(position: Floats, asked: Floats, surplus: Floats, following: NDArray[np.bool_]) -> Law | None:
    """Returns the law with the shortest memory that the force obeys, or else one with some memory; None if too few
    samples follow each other. `following`: as from the function of this name."""
    found = None
    for memory in (1, *_MEMORIES):
        law = _law(position, asked, surplus, following, memory)
        if law is None or law.obeyed:
            return law or found
        found = law if memory <= _MEMORY else found
    return found


def _law(position: Floats, asked: Floats, surplus: Floats, following: NDArray[np.bool_], memory: int) -> Law | None:
    """Returns the law of the force in the `memory` + 1 newest positions and, beyond two of them, in earlier forces, of
    the scene and in all: filters, the device's own sensor and predictors use them. None if too few samples follow each
    other."""
    whole = np.all([following[i : following.size - memory + 1 + i] for i in range(memory)], axis=0)
    rows = memory + np.flatnonzero(whole)
    rows = rows[rows > (memory + 1) * (memory > 1)]  # what remembers begins otherwise than it goes on
    if rows.size < 8 + 4 * memory:
        return None
    size, most = float(np.max(np.abs(position))) or 1.0, float(np.max(np.abs(asked))) or 1.0
    columns = [position[rows] / size]
    columns += [(position[rows - i] - position[rows - i - 1]) / size for i in range(memory)]
    columns += [force[rows - i] / most for force in (asked, surplus) for i in range(1, memory)]
    table = np.column_stack([*columns, np.ones(rows.size)])
    scale = np.maximum(np.linalg.norm(table, axis=0), 1e-300)
    law = np.linalg.lstsq(table / scale, asked[rows] / most, rcond=1e-13)[0] / scale
    missed = asked[rows] / most - table @ law
    obeyed = bool(np.max(np.abs(missed)) <= (_LAWFUL if memory == 1 else _EXACT))
    past = np.roots(np.append(1.0, -law[memory + 1 : 2 * memory])).astype(complex)
    past = np.where(np.abs(past) > 1.0, 1.0 / past.conj(), past)[np.abs(past) > _LITTLE]
    if abs(law[0]) <= _NO_SPRING * float(np.max(np.abs(law[: memory + 1]))):
        return Law(memory, obeyed, True, 0.0, 0.0, past)
    uncertainty = size / abs(law[0]) * float(np.sqrt(np.mean(missed**2) / rows.size))
    return Law(memory, obeyed, False, float(-law[-1] / law[0] * size), uncertainty, past)
