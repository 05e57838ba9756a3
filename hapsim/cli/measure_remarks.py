"""What is said beside a measured k and b: of the runs that led to it, and of dry friction."""

from __future__ import annotations

import math
from collections.abc import Iterator
from itertools import pairwise

import numpy as np

from hapsim.measuring.measure_trace import Measurement
from hapsim.number_format import number, percent
from hapsim.scene import Scene


def attempts(measurement: Measurement) -> Iterator[str]:
    """Yields what became of each run at a position before the one that is printed, and of that one if the hand left
    its region."""
    for one, following in pairwise(measurement.attempts):
        why = f"the hand left its region ({one.left})" if one.left else _unsure(one.uncertainty)
        yield f"With pushes of {number(one.push_n, 3)} N {why}; repeated with {number(following.push_n, 3)} N."
    if measurement.left_region:
        yield (
            f"[yellow]With pushes of {number(measurement.push_n or 0.0, 3)} N the hand left its region[/yellow] "
            f"({measurement.left_region}): what is measured mixes several slopes, and says nothing of the device. "
            "Without --push, hapsim finds a push that stays in the region."
        )


def smaller_push(asked: float | None, measurement: Measurement) -> Iterator[str]:
    """Yields how hard the hand was pushed, where that is less than the N that were asked for."""
    most = measurement.push_n
    if asked is not None and most is not None and most < 0.99 * asked:
        yield f"Pushed with {number(most, 3)} N at most: more would exceed the force limit, or take the hand too far."


def _unsure(share: float) -> str:
    return f"k or b was uncertain by {percent(share, 2)}" if math.isfinite(share) else "nothing was clear of the noise"


def dry_friction(scene: Scene, measurement: Measurement, channel: int) -> Iterator[str]:
    """Yields the dry friction that the motion shows, or that the scene declares, and what it is in a swing of the same
    size: the viscous friction that takes as much energy."""
    seen, declared = measurement.dry_friction_n, scene.mock_device.coulomb
    dry, swing = seen or declared, 0.5 * float(np.ptp(measurement.trace.position[:, channel], axis=0))
    angular = 2.0 * math.pi * measurement.frequency_hz
    takes = 4.0 * dry / (math.pi * angular * swing) if swing > 0.0 else math.nan
    like = f"like another {number(takes, 2)} N·s/m" if math.isfinite(takes) else "the more"
    damps = f"at the largest swing, {number(1e3 * swing, 2)} mm, it damps {like}, at smaller ones more"
    if math.isnan(seen):
        yield (
            "[yellow]The device has dry friction[/yellow], as its motion shows, but not how much: k and b may be off "
            "by more than is stated. Push harder (--push), so that it sticks less."
        )
    elif seen > 0.0:
        yield (
            f"[yellow]The device has dry friction of {number(seen, 3)} N[/yellow], as its motion shows: k and b are "
            f"those without it; {damps}."
        )
    elif declared > 0.0 and swing > 0.0:
        yield (
            f"The prediction leaves out the dry friction of {number(dry, 3)} N (mock.coulomb): {damps}. Push harder "
            "(--push) for less of it."
        )
