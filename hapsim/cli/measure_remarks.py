"""Remarks on a measured k and b: runs, dry friction, limits, another device, and the felt mass."""

from __future__ import annotations

import math
from collections.abc import Iterator
from itertools import pairwise
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from hapsim.cli.command_options import require_positive
from hapsim.cli.output import output_units
from hapsim.errors import UsageError
from hapsim.loop.ring import FADED, LIMITED, SLEWED
from hapsim.number_format import percent
from hapsim.scene.values import per_channel

if TYPE_CHECKING:
    from hapsim.cli.measure_options import ExcitationOptions
    from hapsim.measuring.diagnosis import Diagnosis
    from hapsim.measuring.measure_trace import Attempt, Measurement
    from hapsim.prediction import Prediction
    from hapsim.scene import Scene


_UNSURE = 4.0  # uncertainties: a larger value has a certain sign
_OVER = 0.01  # of a motion: the rest is not seen


def of_mock(scene: Scene) -> str:
    """Returns the end of a title, which names the mock if that is the device, and a hand that adds to k and b."""
    if scene.device.port is not None:
        return ""
    hand = scene.mock_device.hand
    holds = any(any(per_channel(one, scene.channels)) for one in (hand.stiffness, hand.damping))
    return f", on the built-in mock{' and with its hand, which adds to k and b (mock.hand)' * holds}"


def attempts(measurement: Measurement) -> Iterator[str]:
    """Yields the result of each run before the printed one, and of that one if the hand left its region."""
    for one, following in pairwise(measurement.attempts):
        why = f"the hand left its region ({one.left})" if one.left else _unsure(one)
        most, next_most = output_units()(one.push_n, "N", 3), output_units()(following.push_n, "N", 3)
        yield f"With pushes of {most}, {why}; repeated with {next_most}."
    if measurement.left_region:
        push = output_units()(measurement.push_n or 0.0, "N", 3)
        yield (
            f"[yellow]With pushes of {push}, the hand left its region[/yellow] ({measurement.left_region}): k and b "
            "mix several slopes, and do not describe the device. Without --push, hapsim finds a push that stays in the "
            "region."
        )


def smaller_push(asked: float | None, most: float | None) -> Iterator[str]:
    """Yields the largest push, N, if it is less than requested."""
    if asked is not None and most is not None and most < 0.99 * asked:
        pushed = output_units()(most, "N", 3)
        yield f"Pushed with {pushed} at most: more would exceed the force limit, or take the hand too far."


def _unsure(one: Attempt) -> str:
    if math.isfinite(one.uncertainty):
        return f"k or b was uncertain by {percent(one.uncertainty, 2)}"
    return "the hand moved too little" if math.isnan(one.k) else "the motion was lost in the noise"


def dry_friction(scene: Scene, measurement: Measurement, channel: int) -> Iterator[str]:
    """Yields the dry friction that the motion shows, or that the scene declares, and the viscous friction that takes as
    much energy from a swing of the same size."""
    seen, declared = measurement.dry_friction_n, scene.mock_device.coulomb
    dry, swing = seen or declared, 0.5 * float(np.ptp(measurement.trace.position[:, channel], axis=0))
    angular = 2.0 * math.pi * measurement.frequency_hz
    takes = 4.0 * dry / (math.pi * angular * swing) if swing > 0.0 else math.nan
    units = scene.units_of(channel)
    like = f"like another {units(takes, 'N·s/m', 2)}" if math.isfinite(takes) else "the more"
    damps = f"at the largest swing, {units(swing, 'mm', 2)}, it damps {like}, at smaller ones more"
    if math.isnan(seen):
        yield (
            "[yellow]The device has dry friction[/yellow], as its motion shows, but not how much: k and b may be off "
            "by more than is stated. Push harder (--push), so that it sticks less."
        )
    elif seen > 0.0:
        yield (
            f"[yellow]The device has dry friction of {units(seen, 'N', 3)}[/yellow], as its motion shows: k and b are "
            f"those without it; {damps}."
        )
    elif declared > 0.0 and swing > 0.0:
        yield (
            f"The prediction leaves out the dry friction of {units(dry, 'N', 3)} (mock.coulomb): {damps}. Push harder "
            "(--push) for less of it."
        )


def play(scene: Scene, measurement: Measurement, channel: int) -> Iterator[str]:
    """Yields what declared play between motor and handle does to k and b, of which the prediction is that in mesh."""
    size = scene.device.drives(scene.channels)[channel].backlash
    swing = 0.5 * float(np.ptp(measurement.trace.position[:, channel], axis=0))
    if size > 0.0:
        units = scene.units_of(channel)
        yield (
            f"The prediction is that of meshed teeth. The declared backlash of {units(size, 'mm', 2)} parts motor and "
            f"handle at each turn of the motion, here a swing of {units(swing, 'mm', 2)}. It is the likely reason if k "
            "and b differ. They differ less in larger swings (--push)."
        )


def _shaped_ticks(measurement: Measurement) -> tuple[int, int, int, int]:
    """Returns how many ticks there were, and how many of them at the force limit, at the slew limit and outside the
    travel: of the whole run, or once a hand that was led is at its place."""
    report, flags = measurement.trace.report, measurement.trace.flags
    if measurement.at_m is None:
        return report.ticks, report.limited_ticks, report.slewed_ticks, report.faded_ticks
    limited, slewed, faded = (int((flags & flag != 0).sum()) for flag in (LIMITED, SLEWED, FADED))
    return flags.size, limited, slewed, faded


def limits(measurement: Measurement) -> Iterator[str]:
    """Yields the motions for which k and b hold, if something limited the force."""
    in_all, limited, slewed, faded = _shaped_ticks(measurement)
    for ticks, place, holds in (
        (limited, "at the force limit", "stay below it; beyond, the hand feels less"),
        (slewed, "at the slew limit or in the soft start", "are slower; in these the hand feels less"),
        (faded, "outside device.travel or at a position that stood still, where the force fades", "stay within it"),
    ):
        if ticks:
            many = f"{ticks} of {in_all} ticks were {place}"
            yield f"[yellow]{many}[/yellow]: k and b hold for motions that {holds}."


def unstable(measurement: Measurement) -> Iterator[str]:
    """Yields what a negative b means."""
    if measurement.dominant and measurement.b < -_UNSURE * measurement.b_uncertainty:
        yield "[yellow]b is negative[/yellow]: the swing grows by itself, and the loop on this device is unstable."


def too_fast(measurement: Measurement) -> Iterator[str]:
    """Yields how soon the motion is over, if k and b are not known well for that reason."""
    if measurement.too_fast:
        samples = math.ceil(math.log(_OVER) / math.log(abs(measurement.pole)))
        yield (
            f"[yellow]Too fast to tell[/yellow]: the motion is over within {samples} samples, and k is uncertain by "
            f"{percent(measurement.k_uncertainty / abs(measurement.k), 2)}. A higher rate, finer counts or a larger "
            "push (--push) shows more."
        )


def other_device(diagnosis: Diagnosis, measurement: Measurement, of_mass: str) -> Iterator[str]:
    """Yields the difference between the device and the scene's declaration."""
    second, mass = diagnosis.second_mode, diagnosis.probable_mass
    if diagnosis.link_changed:
        yield (
            "[yellow]k is not the predicted one, and the scene's force followed no single linear law[/yellow]: a link "
            "may have touched, released or slid during the record. k and b then mix its states, and the prediction "
            "holds for only one of them. Measure a smaller motion, which leaves the link in one state. If k is still "
            "far off, the device is not as the scene declares it."
        )
    elif second is not None and diagnosis.gives:
        yield (
            f"[yellow]Something swings along[/yellow] at {second.frequency_hz:.3g} Hz, damping ratio "
            f"{second.damping_ratio:.2g}, with {percent(second.share, 3)} of the motion's energy: the hand, or a part "
            "of the device, moves against the rest like a mass on a spring; or dry friction bends the motion, which "
            "`hapsim identify` finds. k and b are those of the longest ringing mode, not what the hand feels."
        )
    elif mass is not None:
        share = mass.factor
        felt = output_units().spring("kb", share * measurement.k, share * measurement.b, ".6g")
        yield (
            f"[yellow]The mass is probably {share:.3g} times the {of_mass} one[/yellow], "
            f"{output_units()(mass.mass, 'kg', '.4g')}: with it the prediction has the eigenfrequency and the damping "
            f"ratio that were measured, and the hand feels {felt}. `hapsim identify --write` measures and stores it."
        )
    elif (delay := diagnosis.probable_delay) is not None:
        yield (
            f"[yellow]The delay is probably {delay:.3g} samples[/yellow]: with it the prediction has the k and b that "
            "were measured, and no friction explains so little damping. The firmware or the wire is later than the "
            "scene declares; `hapsim identify --write` measures and stores it."
        )
    elif diagnosis.is_another_device:
        yield (
            "[yellow]Measured and predicted are much further apart than the uncertainty[/yellow]: the device is not as "
            "the scene declares it, or has dry friction. `hapsim identify` finds what it is."
        )


class MeasuredWeight(NamedTuple):
    """Felt masses in kg, and the stiffness of the hand in N/m."""

    hand_stiffness: float
    measured: float
    uncertainty: float
    predicted: float | None
    continuous: float | None
    """Predicted, without sampling and delay."""


def with_hand(scene: Scene, channel: int, stiffness: float | None) -> Scene:
    """Returns the scene whose mock is held by a hand of this stiffness, N/m (None: by that of the scene). UsageError
    where no hand holds the mock, or that of a device is not known."""
    require_positive("--hand-stiffness", stiffness, scene.units_of(channel).si.name("N/m"))
    if scene.device.port is not None:
        if stiffness is None:
            raise UsageError(
                "--mass: the stiffness of the hand that holds the device is missing; add --hand-stiffness KH"
            )
        return scene
    from hapsim.scene import Mock

    mock = scene.mock or Mock()
    stiffnesses = list(per_channel(mock.hand.stiffness, scene.channels))
    stiffnesses[channel] = stiffnesses[channel] if stiffness is None else stiffness
    if not stiffnesses[channel] > 0.0:
        raise UsageError("--mass: no hand holds the mock; expected mock.hand.stiffness, or --hand-stiffness KH")
    hand = mock.hand.model_copy(update={"stiffness": tuple(stiffnesses)})
    return scene.model_copy(update={"mock": mock.model_copy(update={"hand": hand})})


def measured_weight(
    scene: Scene, prediction: Prediction, measurement: Measurement, channel: int, excitation: ExcitationOptions
) -> MeasuredWeight:
    """Returns the measured and the predicted felt mass."""

    stiffness = excitation.hand_stiffness
    if stiffness is None:
        assert scene.mock is not None
        stiffness = float(per_channel(scene.mock.hand.stiffness, scene.channels)[channel])
    one = prediction.part_on(channel)
    predicted = None if one is None else one.weighs(stiffness)
    return MeasuredWeight(stiffness, *measurement.felt_mass(stiffness), *(predicted or (None, None)))


def weight_sentence(weight: MeasuredWeight, channel: int) -> str:
    """Returns the felt mass in words."""
    units = output_units(channel)
    hand = f"a hand of {units(weight.hand_stiffness, 'N/m', 4)}"
    if not math.isfinite(weight.measured):
        return f"Held by {hand}, nothing was seen to oscillate: its felt mass is unknown"
    if weight.measured <= 0.0:
        return f"Held by {hand}, it oscillates no slower than the device alone: the felt mass is zero"
    off = weight.uncertainty
    known = units.number(weight.measured, "kg", 4)
    if math.isfinite(off):
        known = f"{units.rounded(weight.measured, off, 'kg')} ± {units.number(off, 'kg', 1)}"
    sentence = f"Moved to and fro by {hand}, it feels like {units(known, 'kg')}"
    if weight.predicted is not None and weight.continuous is not None and math.isfinite(weight.predicted):
        plain = units.number(weight.continuous, "kg")
        sentence += f" (predicted: {units.number(weight.predicted, 'kg')}; without sampling and delay {plain})"
    elif weight.predicted is None:
        sentence += " (not predicted: that is done for one hand and a loop of at most a hundred numbers)"
    return sentence
