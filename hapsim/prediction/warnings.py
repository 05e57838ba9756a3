"""Warnings before a scene runs.

They include modules that are too stiff, or damp too much, for CORDIS's scheme by themselves, and the substeps that they
need.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from typing import Any

import numpy as np

from hapsim.number_format import frequency, rounded_down
from hapsim.prediction.characteristic import hand_at
from hapsim.prediction.force_bounds import ARMED_INSIDE, run_bounds, slew_warning
from hapsim.prediction.linear import linear_scene, network_of
from hapsim.prediction.plausibility import begun_inside, unlikely
from hapsim.prediction.predict import Prediction, is_surely_unstable
from hapsim.scene import Scene
from hapsim.scene.mock_limits import mock_refusal
from hapsim.scene.modules import Link
from hapsim.scene.quantity import expectation_of
from hapsim.scene.written_units import has_dimension
from hapsim.theory import Network
from hapsim.theory.network.network import BACKWARD
from hapsim.theory.schemes import SCHEMES


def warnings_about(scene: Scene, prediction: Prediction) -> list[str]:
    """Returns sentences on risks of `scene`, which has this prediction; an empty list if there are none."""
    hints = unlikely(scene)
    if scene.ports:
        return [*dict.fromkeys(one for each in prediction.every for one in _about(each.scene, each, hints))]
    return _about(scene, prediction, hints)


def _about(scene: Scene, prediction: Prediction, hints: list[str]) -> list[str]:
    """Returns these hints about the values of the scene, and the risks that they may explain."""
    work, limit = ARMED_INSIDE * run_bounds(scene).energy_limit, scene.mock_device.force_limit
    warnings = [*hints, *_out_of_range(scene), *begun_inside(scene, work)]
    if scene.device.port is None and (refusal := mock_refusal(scene)):
        warnings.append(f"the built-in mock cannot run this scene. {refusal}.")
    if not prediction.by_its_scheme:
        warnings.append(
            f"stability was worked out for scheme: cordis; the scene runs with scheme: {scene.scheme}."
            if scene.substeps == 1
            else "stability was worked out for a device that samples with every substep; the scene's device does not."
        )
    elif is_surely_unstable(prediction):
        warnings.append(
            "the scene is predicted unstable: `hapsim run` and `measure` refuse it. With --unstable the device "
            f"{oscillation(scene, prediction)}"
        )
        warnings += own_limits(scene)
    for name in prediction.trembles:
        swing = prediction.judge.swings[name]
        warnings.append(
            f"{name} oscillates by {swing.sentence(scene.units) if swing else ''}, less than a count, where a piece of "
            "its links is too stiff for the loop. A smoother table prevents it."
        )
    if prediction.judge.swings_on:
        for name, swing in prediction.judge.swings.items():
            ways = swing.sentence(scene.units_at(name)) if swing else ""
            warnings.append(f"after a knock or under a steady press, {name} swings by {ways}.")
    if prediction.states.unjudged:
        warnings.append(
            "not every state of the contacts was judged: they are too many, or take too long. The scene may shake the "
            "hand in one of them."
        )
    for name in prediction.regions:
        hand = hand_at(scene, name)
        x = max(hand.edges(), key=lambda x: abs(float(hand.force(x))), default=0.0)
        if abs(float(hand.force(x))) > limit:
            warnings.append(
                f"{name} at {hand.units(x, 'm')}: the scene's force is {hand.units(abs(float(hand.force(x))), 'N')}; "
                f"the force limit clips it to {hand.units(limit, 'N', 'g')}."
            )
    slow = slew_warning(scene, prediction)
    warnings += [slow] if slow else []
    for one in (one for one in prediction.desired if one.remedies is not None):
        off = f", off by {100.0 * one.error:.1f} %" if math.isfinite(one.error) else ""
        units = scene.units_of(scene.device_points[one.name].channel)
        warnings.append(
            f"correction {scene.device.correction} does not reach k = {units(one.k, 'N/m', '.6g')}, "
            f"b = {units(one.b, 'N·s/m', '.6g')} at {one.name}: the nearest that it reaches is simulated{off}. "
            "`hapsim check` lists the remedies."
        )
    is_explained = any(re.match(r"(rate|device\.baud|devices\.[^.]+\.baud): ", one) for one in warnings)
    return [*warnings, *_of_wire(scene, prediction, is_explained)]


def _out_of_range(scene: Scene) -> Iterator[str]:
    """Yields a sentence for each value outside the range that its file gives it."""
    sections: dict[object, Any] = {"modules": scene.modules, "sound": scene.sound, "mock": dict(scene.mock or ())}
    for (section, name, key), (low, high) in scene.ranges.items():
        part, units = sections[section].get(name), scene.units_at(str(name))
        value = getattr(part, str(key), low)
        off = [one for one in (value if isinstance(value, tuple) else (value,)) if not low <= one <= high]
        if off and (expected := expectation_of(type(part).model_fields[str(key)])):
            unit = expected.unit if has_dimension(expected.unit) else ""
            found, least, most = (units(one, unit) if unit else f"{one:g}" for one in (off[0], low, high))
            within = f"a value within its range, {least} to {most}: a slider does not reach it"
            yield f"{section}.{name}.{key}: found {found}, expected {within}. Correct the value or the range."


def _of_wire(scene: Scene, prediction: Prediction, is_explained: bool) -> Iterator[str]:
    """Yields a sentence on a wire that is too slow. `is_explained`: a mistake in rate or baud is named already."""
    budget = prediction.wire_time
    if prediction.wire_delay:
        yield f"{prediction.wire_delay}. The prediction is for that delay."
    elif prediction.wire_of == "unknown" and not budget.fits and not is_explained:
        delay = "the frames queue up"
        if not budget.is_saturated:
            felt = "`hapsim check` prints what the hand then feels"
            delay = f"the delay is {budget.delay_samples} samples instead of one ({felt})"
        yield (
            f"an exchange takes {budget.exchange_s * 1e3:.4g} ms at {scene.device.baud} baud, including the host's "
            f"work; the sample period is {budget.period * 1e3:.4g} ms. On a UART {delay}. "
            "A USB device without a UART is not affected."
        )


def oscillation(scene: Scene, prediction: Prediction) -> str:
    """Sentence, to follow the device, on how an unstable scene oscillates."""
    swings = prediction.judge.swings.items()
    worst = max((one for one in swings if one[1]), key=lambda one: one[1].most if one[1] else 0.0, default=None)
    so_far = "how far was not worked out"
    if worst is not None and worst[1] is not None:
        so_far = f"in simulation {worst[0]} swings by {worst[1].sentence(scene.units_at(worst[0]))}"
    most = most_speed(scene) if scene.device.is_admittance else most_force(scene)
    return f"oscillates with up to {most}; {so_far} (hapsim/STABILITY.md: when a guard ends the run)."


def most_speed(scene: Scene) -> str:
    """Phrase for the bound of an unstable scene's commands in admittance."""
    fastest, channels = scene.device.speed_limits(scene.channels), range(scene.channels)
    return " and ".join(dict.fromkeys(scene.units_of(c)(fastest[c], "m/s", "g") for c in channels))


def most_force(scene: Scene) -> str:
    """Phrase for the bound of an unstable scene's force: its limit, or the sum of all links of a hand."""

    def of_link(link: Link) -> float:
        law = link.law()
        return math.inf if law.speeds else law.strongest(scene.rate)

    links = [*(scene.links | scene.plane_links).values()]  # of which one ends at a hand's own name
    pulls = {
        hand.channel: sum(of_link(link) for link in links if {name, name.partition(".")[0]} & {*link.between})
        for name, hand in scene.device_points.items()
    }
    channel = max(pulls, key=pulls.__getitem__)
    limit = scene.mock_device.force_limit
    if pulls[channel] >= limit:
        return f"the force limit of {scene.units(limit, 'N', 'g')}"
    return f"the {scene.units_of(channel)(pulls[channel], 'N')} of its links"


_MOST = 4.0  # of (K T² + 2 B T)/M
_DENSE = 500  # masses for a dense computation of the largest value; above, by iteration
_MOST_SUBSTEPS = 1000  # of a scene


def own_limits(scene: Scene) -> Iterator[str]:
    """Yields a sentence for each module of `scene` that exceeds its own limit. If only all of them together exceed it,
    the sentence is about the one that comes nearest."""
    linear = linear_scene(scene)
    if SCHEMES[scene.scheme] is not None or not linear.masses:
        return
    network, _ = network_of(scene, linear)
    owner = np.array([*linear.links, *(one.between[0].partition(".")[0] for one in linear.inner)])
    every, rate = np.full(owner.size, True), scene.step_rate
    found = {name: _largest(network, owner == name, rate) for name in dict.fromkeys(owner.tolist())}
    whole = _largest(network, every, rate)
    if not whole > _MOST:
        return
    steps, largest = scene.substeps, whole
    while largest > _MOST and steps <= _MOST_SUBSTEPS:
        steps = max(steps + 1, math.floor(steps * math.sqrt(largest / _MOST)))  # never more than the springs need
        largest = _largest(network, every, steps * scene.rate)
    remedy = f"use {steps} substeps instead of {scene.substeps}" if steps <= _MOST_SUBSTEPS else "add mass there"
    for name in [one for one in found if found[one] > _MOST] or [max(found, key=found.__getitem__)]:
        own, alone = owner == name, found[name] > _MOST
        stiffness, damping = (float(values[own].max()) for values in (network.stiffness, network.damping))
        damps = 2.0 * damping * rate > stiffness
        value, unit = (damping, "N·s/m") if damps else (stiffness, "N/m")
        units = scene.units_at(name)
        stable = units(value * _MOST / found[name], unit, rounded_down)
        most = f"more than the {stable} with which its masses are stable"
        why = most if alone else "too much, with the modules joined to it,"
        yield f"{name}: {units(value, unit)} is {why} in steps of {frequency(rate)}; {remedy}."


def _largest(network: Network, links: Any, rate: float) -> float:
    """Returns the largest (K T² + 2 B T)/M of a mode of these links, (L,) bools, at `rate` Hz. A damper that uses more
    than the last two positions does not count: at z = -1 it damps less, or not at all."""
    from scipy.sparse import coo_array
    from scipy.sparse.linalg import svds

    hands = network.channel_mass.size
    links = np.flatnonzero(links & (network.ends.max(axis=1) >= hands))
    plain = np.array([network.damper[link] == BACKWARD for link in links])
    weight = network.stiffness[links] / rate**2 + 2.0 * network.damping[links] * plain / rate
    ends = network.ends[links] - hands
    row, side = np.nonzero(ends >= 0)
    mass = ends[row, side]
    moved = np.where(network.implicit, np.inf, network.point_mass)[mass]  # an implicit step has no such limit
    entry = np.sqrt(np.maximum(weight[row], 0.0) / moved) * (1.0 - 2.0 * side)
    _, column = np.unique(mass, return_inverse=True)
    matrix = coo_array((entry, (row, column)), shape=(links.size, column.max(initial=0) + 1)).tocsr()
    if min(matrix.shape) <= _DENSE:
        return float(np.linalg.norm(matrix.toarray(), 2)) ** 2 if links.size else 0.0
    return float(svds(matrix, 1, return_singular_vectors=False, tol=1e-3)[0]) ** 2
