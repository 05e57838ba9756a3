"""Lines of `hapsim check` about hands that links tie across devices, each with a clock of its own."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from typing import TYPE_CHECKING, Any

import numpy as np
from rich.markup import escape

from hapsim.cli import check_details as details
from hapsim.cli import check_hands
from hapsim.cli.output import Line, table
from hapsim.documents import pick
from hapsim.number_format import duration, listed, number
from hapsim.prediction import host_silence
from hapsim.prediction.force_bounds import guard_sentence, run_bounds, travel_document
from hapsim.prediction.predict import predict_on_wire, prediction_of
from hapsim.prediction.predict_ports import AcrossPorts, PortsPrediction
from hapsim.prediction.timing import on_wire
from hapsim.prediction.verdict_words import margin_summary, predicted_for, state_sentences
from hapsim.scene.scaled_links import scale_sentences
from hapsim.theory.network.phases import moving_ports, phases_on_axis
from hapsim.theory.several_clocks import noise_gain

if TYPE_CHECKING:
    from hapsim.prediction import Part, Prediction
    from hapsim.prediction.over_phases import OverPhases
    from hapsim.scene import Scene

_APART = 50e-6  # of two clocks: two ordinary crystals
_SHAKEN = 10.0  # m/s²: about what a hand does
_COUNT = 10e-6  # m: of an ordinary encoder


def across_lines(scene: Scene, prediction: AcrossPorts, explain: bool) -> Iterator[Line]:
    """Yields the prediction of hands that links tie across devices. `scene`: of all devices."""
    devices = {port: scene.with_others_held(port) for port in prediction.ports}
    yield from map(escape, _alike({port: [predicted_for(one)] for port, one in devices.items()}))
    if explain:
        yield from details.assumption_lines(prediction.assumptions)
    yield _clock_sentence(prediction)
    for part in prediction.parts:
        yield from _felt_lines(prediction, part, explain)
    yield from map(escape, state_sentences(prediction))
    yield from map(escape, scale_sentences(prediction.scene))
    if explain:
        yield from check_hands.any_hand_sentences(prediction)
        yield from map(escape, price_sentences(prediction))
        yield from details.mode_lines(prediction)
        yield from details.margin_lines(prediction)
    else:
        yield escape(margin_summary(prediction))
        yield from details.assumption_lines(prediction.assumptions)
    yield from _alike({port: _device_lines(one, explain) for port, one in devices.items()})


def _device_lines(scene: Scene, explain: bool) -> Iterator[str]:
    """Yields the wire and the bounds of one device."""
    alone = prediction_of(scene, with_margins=False)
    yield from map(str, details.wire_lines(alone, predict_on_wire(scene), explain))
    yield guard_sentence(scene)
    yield from details.travel_sentences(scene)


def _alike(sentences: dict[str, Iterable[str]]) -> Iterator[str]:
    """Yields sentences about devices, each after the names of those that it is about."""
    found: dict[str, list[str]] = {}
    for port, own in sentences.items():
        for sentence in own:
            found.setdefault(sentence, []).append(port)
    return (f"{listed(ports)}: {sentence}" for sentence, ports in found.items())


def _clock_sentence(prediction: AcrossPorts) -> str:
    names, network = escape(listed(prediction.ports)), prediction.network
    if not moving_ports(network):
        return f"{names} have the host's clock: its jitter reaches the hands"
    on_axis, moving = phases_on_axis(network), len(moving_ports(network))
    grid = f"{on_axis**moving} phases{f' ({on_axis} of each device against the first)' if moving > 1 else ''}"
    return f"{names} have clocks of their own: felt is the least and the most over {grid}, with their extremes refined"


def _felt_lines(prediction: AcrossPorts, part: Part, explain: bool) -> Iterator[Line]:
    """Yields k and b of a part over all phases, beside the desired ones, and sentences about them."""
    found, scene, who = part.over_phases, prediction.scene, escape(listed(part.names))
    if found is None or found.reason:
        yield from check_hands.sentences_of(prediction, part)
        return
    rows = [*_tie_rows(scene, part, found)]
    rows += _rows(scene, part, found) if explain or not rows else []
    yield table("", ("", "desired", "least", "most", "static", ""), rows, box=None)
    if found.tie is None or found.desired_tie is None:
        yield f"{who}: k and b of their own oscillation (of another hand: between them)"
        return
    least, most = (number(-one.together_per_s, 4) for one in reversed(found.tie))
    yield (
        f"{who}: one spring and damper between them, on their reduced mass, with the devices' friction. Moved "
        f"together, they lose speed at {least} to {most} /s (desired: {-found.desired_tie.together_per_s:.4g} /s)"
    )


def _tie_rows(scene: Scene, part: Part, found: OverPhases) -> Iterator[tuple[str, ...]]:
    if found.tie is not None and found.desired_tie is not None:
        (least, most), wanted, units = found.tie, found.desired_tie, scene.units_at(part.names[0])
        k = (wanted.k, least.k, most.k, float(part.static_stiffness[0, 0]))
        yield from check_hands.pair_rows(" to ".join(part.names), units, k, (wanted.b, least.b, most.b))


def _rows(scene: Scene, part: Part, found: OverPhases) -> Iterator[tuple[str, ...]]:
    """Yields rows for each hand, and for what it feels of each other hand."""
    for i, hand in enumerate(part.names):
        for j, of in enumerate(part.names):
            sign, ends = (1.0, (0, 1)) if i == j else (-1.0, (1, 0))
            k, b = ([sign * float(pair[end][i, j]) for end in ends] for pair in (found.k, found.b))
            desired_k, desired_b = (sign * float(one[i, j]) for one in (part.desired.k, part.desired.b))
            static = sign * float(part.static_stiffness[i, j])
            who = escape(hand) + (f" of {escape(of)}" if i != j else "")
            names = check_hands.names_between(scene.units_at(hand), scene.units_at(of)) if i != j else None
            units = scene.units_at(hand) if names is None else scene.units_at(hand).si
            yield from check_hands.pair_rows(who, units, (desired_k, *k, static), (desired_b, *b), names)


def price_sentences(prediction: AcrossPorts) -> Iterator[str]:
    """Yields what two clocks cost each link across devices: the step where their phase wraps, and noise."""
    if not moving_ports(prediction.network):
        return
    period, noise = 1.0 / prediction.rate, noise_gain(1.0)
    yield (
        f"The phase of two clocks wraps once in {duration(period / _APART)} if they differ by {1e6 * _APART:g} ppm. A "
        f"port's damper takes noise of another's positions {noise_gain(0.0):.3g} to {noise:.3g} times B/T"
    )
    for name, link in prediction.links_across.items():
        units = prediction.scene.units_at(name)
        step = units(link.stiffness * _SHAKEN * period**2, "N", 2)
        rms = units(noise * link.damping / period * _COUNT / math.sqrt(12.0), "N", 2)
        yield (
            f"{name}: where it wraps, the force steps by {step} at most, at {units(_SHAKEN, 'm/s²')}; counts of "
            f"{units(_COUNT, 'µm')} add up to {rms} rms"
        )


_INTERFACE = "delay hold sampling decimation"


def document(scene: Scene, prediction: PortsPrediction) -> dict[str, Any]:
    """Returns the keys of `hapsim check --json` of a scene of several devices that are not those of one."""
    parts = [
        {"devices": ports} | _part_document(one, part)
        for ports, one in prediction.sections.items()
        for part in one.parts
    ]
    devices = {}
    for port in scene.ports:
        own = scene.with_others_held(port)
        alone = prediction_of(own, with_margins=False)
        devices[port] = {
            **pick(on_wire(own).device, _INTERFACE),
            "wire_time": pick(alone.wire_time, "* exchange_s fits delay_samples highest_rate_hz")
            | {"of": alone.wire_of},
            "force_bounds": run_bounds(own),
            "travel": travel_document(own),
        }
    return {
        **pick(prediction, "stable verdict spectral_radius assumptions rate_hz=rate nominal_rate_hz=rate"),
        "leader": scene.leader,
        "devices": devices,
        "parts": parts,
        "margins": {one.name: one for one in prediction.margins},
        "host_silence": host_silence(prediction.rate),
    }


def _part_document(prediction: Prediction, part: Part) -> dict[str, Any]:
    """Returns a part: of one on several clocks, [least, most] in place of numbers."""
    any_hand = check_hands.any_hand_document(part.any_hand, None)
    whole, found = check_hands.part_document(prediction, part) | {"any_hand": any_hand}, part.over_phases
    if found is None:
        return whole
    k, b = (None if found.reason else np.stack(one, axis=-1) for one in (found.k, found.b))
    tie = None
    if found.tie is not None:
        names = found.tie[0]._fields
        tie = {name: [getattr(one, name) for one in found.tie] for name in names} | {"desired": found.desired_tie}
    phases = phases_on_axis(part.network) if moving_ports(part.network) else 0
    ranged = {"k": k, "b": b, "tie": tie, "phases": phases, "reason": found.reason}
    return {key: one for key, one in whole.items() if key not in _OF_ONE_PHASE} | ranged


_OF_ONE_PHASE = ("alone", "hands", "kinetic_share", "other_motions", "frequencies_hz", "moved", "regions", "weight")
