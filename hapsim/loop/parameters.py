"""Live parameters: stiffness, damping and rest positions, changed while the loop runs.

Another thread posts a whole set of values; the loop takes it between two samples, all or nothing, and leads every value
from where it is to where it shall be along

    v(s) = v0 + (v1 - v0) (3 s² - 2 s³),     s = 1/N, 2/N, ... 1

over N samples: it begins and ends without a kink, and no value moves by more than 1.5/N of its way in one sample. A set
that comes meanwhile is taken at once, from wherever the values are.

The loop never waits: while a set is being written it goes on with what it has, and looks again at the next sample.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hapsim.compiled import inlined, jit, part
from hapsim.loop.ordering import fence

_MAIL = np.dtype(
    [
        ("posted", np.int64),  # counts up by two a set; odd while one is being written
        ("taken", np.int64),  # `posted` of the set that was taken last
        ("sets", np.int64),  # that were taken
        ("posted_samples", np.int64),  # N of the posted set
        ("samples", np.int64),  # N of the set that was taken last
        ("left", np.int64),  # samples until the values stand where they shall
    ],
    align=True,
)


class Parameters(NamedTuple):
    """P values that can be changed, each array of shape (P,), in the units that the program keeps them in."""

    now: NDArray[np.floating[Any]]
    """What the tick works with."""
    posted: NDArray[np.float64]
    incoming: NDArray[np.float64]
    origin: NDArray[np.float64]
    target: NDArray[np.float64]
    mail: np.void


def parameters_of(values: NDArray[np.floating[Any]]) -> Parameters:
    """`values` (the tick's own, not a copy) as parameters that stand still."""
    posted, incoming, origin, target = (values.astype(np.float64) for _ in range(4))
    return Parameters(values, posted, incoming, origin, target, np.zeros(1, _MAIL)[0])


@jit
def post(parameters, values, samples):
    """Posts a whole set, to be reached `samples` (>= 1) samples after it is taken. One thread at a time."""
    mail = parameters.mail
    mail.posted += 1
    fence()
    for i in range(values.size):
        parameters.posted[i] = values[i]
    mail.posted_samples = samples
    fence()
    mail.posted += 1


@inlined
def move_parameters(parameters):
    """Before a sample: takes what was posted, and moves the values by one sample. Whether any moved."""
    mail = parameters.mail
    if mail.posted != mail.taken:
        _take(parameters, mail)
    if mail.left == 0:
        return False
    mail.left -= 1
    s = 1.0 - mail.left / mail.samples
    share = s * s * (3.0 - 2.0 * s)
    for i in range(parameters.now.size):
        parameters.now[i] = parameters.origin[i] + share * (parameters.target[i] - parameters.origin[i])
    if mail.left == 0:
        for i in range(parameters.now.size):
            parameters.now[i] = parameters.target[i]  # to the last digit
    return True


@part
def _take(parameters, mail):
    """Takes the posted set, unless it is being written at this moment."""
    number = mail.posted
    if number & 1:
        return
    fence()
    for i in range(parameters.now.size):
        parameters.incoming[i] = parameters.posted[i]
    samples = mail.posted_samples
    fence()
    if mail.posted != number:
        return
    for i in range(parameters.now.size):
        parameters.origin[i] = parameters.now[i]
        parameters.target[i] = parameters.incoming[i]
    mail.taken = number
    mail.sets += 1
    mail.samples = samples
    mail.left = samples
