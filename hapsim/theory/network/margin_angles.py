"""At which angles a scene's answers are worked out, so that none of its poles hides between two of them."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from hapsim.theory.arrays import Complexes, Floats

if TYPE_CHECKING:
    from hapsim.theory.network.margin_modal import ModalResponse
    from hapsim.theory.network.margin_response import Response

EVENLY = 200
FAINT = 0.3  # a pole of smaller modulus does not show on the circle
RESTS = 1e-9  # a pole this close to the circle is on it; closer by, rounding would speak of it
AFFORDABLE = 6e7  # multiplications for a walk along the circle
FINELY = 4.0 * AFFORDABLE  # the same for the hands' links, where they turn fast
TURN = 0.7  # between two angles an answer changes by less than exp of it, in size and in angle
ABOUT = ((0.0, 0.15, 0.4, 0.8, 1.5, 3.0, 7.0, 20.0), (0.0, 0.5, 1.0, 3.0), (0.0, 1.0), (0.0,))  # widths of a resonance


def angles_about(poles: Complexes, work: int) -> Floats:
    """From 0 to pi, close about each pole as far as it is from the circle, and evenly in between.

    Fewer where each is so much ``work`` that a user would wait.
    """
    shown = poles[(poles.imag >= 0.0) & (np.abs(poles) > FAINT)]
    centre, width = np.abs(np.angle(shown)), np.maximum(np.abs(1.0 - np.abs(shown)), RESTS)
    slow = np.abs(shown - 1.0)
    least = max(1e-12, 0.01 * float(slow[slow > 1e-7].min(initial=1.0)))
    towards_pi = math.pi - np.geomspace(1e-6, 0.1, 30)
    spread = np.concatenate([np.geomspace(least, 1.0, EVENLY), np.linspace(0.0, math.pi, EVENLY), towards_pi])
    for about in ABOUT:
        close = centre[:, None] + width[:, None] * np.concatenate([-np.array(about), about])
        angles = np.append(np.concatenate([spread, close.ravel()]), [0.0, math.pi])
        angles = np.unique(angles[(angles >= 0.0) & (angles <= math.pi)])
        if angles.size * work < AFFORDABLE:
            break
    return angles


def angles_for_links(
    response: Response | ModalResponse, links: NDArray[np.intp], angles: Floats
) -> tuple[Floats, bool]:
    """These angles, and more where the answers of the links turn fast; False where time is up before none does."""
    most = min(response.most_angles, int(FINELY / max(1, response.work)))
    wanted = _answers(response, links, angles)
    while angles.size < most:
        with np.errstate(all="ignore"):
            turn = np.abs(np.log(wanted[:, 1:] / wanted[:, :-1])).max(axis=0, initial=0.0)
        fast = np.flatnonzero((turn > TURN) & (np.diff(angles) > 1e-9))
        if not fast.size:
            return angles, True
        fast = fast[np.argsort(-turn[fast], kind="stable")][: most - angles.size]
        more = 0.5 * (angles[fast] + angles[fast + 1])
        every = np.concatenate([angles, more])
        order = np.argsort(every)
        wanted = np.concatenate([wanted, _answers(response, links, more)], axis=1)[:, order]
        angles = every[order]
    return angles, False


def _answers(response: Response | ModalResponse, links: NDArray[np.intp], angles: Floats) -> Complexes:
    """(2 links, n): those of the stiffnesses, then those of the dampings."""
    parts = []
    step = response.at_once(links.size)
    for start in range(0, angles.size, step):
        answer = response.at(angles[start : start + step], links)
        parts.append(np.concatenate([answer.stiffness, answer.damping]))
    return np.concatenate(parts, axis=1)
