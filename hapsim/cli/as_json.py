"""Results as JSON documents. Keys are a contract with scripts; a value that does not exist is null, never NaN."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import asdict, replace
from typing import TYPE_CHECKING, Any

from hapsim.prediction import Desired, Felt, Prediction, felt_at_rate, host_silence, robustness_of

if TYPE_CHECKING:
    from hapsim.errors import HapsimError, RunError
    from hapsim.loop.realtime import PrivilegeResult
    from hapsim.measuring.measure_trace import Measurement
    from hapsim.recording.trace import Report
    from hapsim.running.lifetime import Lifetime


def document(value: dict[str, Any]) -> str:
    """The text of one JSON document."""
    return json.dumps(plain(value), indent=2, allow_nan=False)


def prediction_document(
    prediction: Prediction, channel: int | None = None, on_wire: Prediction | None = None
) -> dict[str, Any]:
    """What `hapsim check` prints; `predicted` and `dominant` are of `channel` (None: the first). `on_wire`: as
    `predict_on_wire` gave it."""
    felt = felt_on(prediction, channel)
    return {
        "rate_hz": prediction.rate,
        "nominal_rate_hz": prediction.rate,
        "stable": prediction.stable,
        "spectral_radius": prediction.spectral_radius,
        "poles_method": prediction.poles_method or "every pole (memories, at zero, are not listed)",
        "poles_in_all": prediction.poles_in_all,
        "dominant": felt is not None and felt.dominant,
        "poles": prediction.poles,
        "predicted": None if felt is None else _felt(felt),
        **_correction_document(prediction, channel),
        "device_points": {one.name: _felt(one) for one in prediction.felt},
        "coupled_device_points": prediction.coupled,
        "assumptions": prediction.assumptions,
        "modes": [
            {
                "pole": mode.pole,
                "frequency_hz": mode.frequency_hz,
                "damping_ratio": mode.damping_ratio,
                "participation": dict(zip(prediction.points, mode.participation, strict=True)),
            }
            for mode in prediction.modes
        ],
        "margins": {
            margin.name: {
                "stiffness_factor": margin.stiffness_factor or None,
                "damping_factor": margin.damping_factor or None,
                "stabilizing_stiffness_factors": margin.stabilizing_stiffness,
                "stabilizing_damping_factors": margin.stabilizing_damping,
            }
            for margin in prediction.margins
        },
        "margins_method": prediction.margins_method or ("every link" if prediction.margins else "none"),
        "wire_time": _wire_document(prediction, channel, on_wire),
        "host_silence": asdict(host_silence(prediction.rate)),
    }


def _correction_document(prediction: Prediction, channel: int | None) -> dict[str, Any]:
    """`desired` and `correction`; nothing without a correction."""
    rendering = prediction.rendering
    if rendering is None or rendering.kind is None:
        return {}
    first = next((one for one in prediction.desired if channel in (None, one.channel)), None)
    return {
        "desired": None if first is None else _desired(first),
        "correction": {
            "name": rendering.kind.name,
            "device_points": {
                port.name: {
                    "written": dict(zip(("K", "B"), port.written, strict=True)),
                    "simulated": dict(zip(("K", "B"), port.rendered, strict=True)),
                    "made_for_kg": port.made_for,
                    "reached": port.reached,
                }
                for port in rendering.ports
            },
            "desired": {one.name: _desired(one) for one in prediction.desired},
            "desired_modes": [
                {"root": mode.root, "frequency_hz": mode.frequency_hz, "damping_ratio": mode.damping_ratio}
                for mode in prediction.desired_modes
            ],
            "notes": rendering.notes,
        },
    }


def _desired(desired: Desired) -> dict[str, Any]:
    values = desired._asdict()
    return values | {"remedies": None if desired.remedies is None else desired.remedies._asdict()}


def _wire_document(prediction: Prediction, channel: int | None, on_wire: Prediction | None) -> dict[str, Any]:
    """`predicted` and what goes with it: at the delay that results, null where the wire costs one sample."""
    budget = prediction.wire_time
    felt = None if on_wire is None else felt_on(on_wire, channel)
    return asdict(budget) | {
        "of": prediction.wire_of,
        "exchange_s": budget.exchange_s,
        "fits": budget.fits,
        "delay_samples": budget.delay_samples,
        "highest_rate_hz": budget.highest_rate_hz,
        "predicted": None if felt is None else _felt(felt) | {"delay": felt.configuration.delay},
        "stable": None if on_wire is None else on_wire.stable,
    }


def measurement_document(
    prediction: Prediction, measurement: Measurement, channel: int, on_wire: Prediction | None = None
) -> dict[str, Any]:
    """What `hapsim measure` prints: prediction and measurement side by side, and how the run went. `rate_hz` is the
    rate that scene and device declare; a device that was seen to sample at another has both sides for that, too."""
    seen = measurement.seen_rate
    at_seen_rate = None
    if seen is not None and seen.differs_from(prediction.rate):
        felt = felt_on(prediction, channel)
        at_seen_rate = {
            "predicted": None if felt is None else _felt(felt_at_rate(felt, seen.rate_hz)),
            "measured": _measured(measurement.at_rate(seen.rate_hz)),
        }
    return measured_document(prediction, measurement.trace.report, channel, measurement.failure, on_wire) | {
        "measured": _measured(measurement) | _device_document(prediction, measurement, channel),
        "rate_seen_hz": None if seen is None else seen.rate_hz,
        "rate_seen_uncertainty_hz": None if seen is None else seen.uncertainty_hz,
        "at_rate_seen": at_seen_rate,
    }


def measured_document(
    prediction: Prediction,
    report: Report,
    channel: int,
    failure: RunError | None = None,
    on_wire: Prediction | None = None,
) -> dict[str, Any]:
    """The same without a measurement: of a run that failed before anything could be identified."""
    run = report_document(report)
    rates = {"rate_hz": prediction.rate, "kept_rate_hz": run.pop("rate_hz")}
    predicted = prediction_document(prediction, channel, on_wire)
    return predicted | {"measured": None} | run | rates | failure_document(failure)


def failure_document(failure: HapsimError | None) -> dict[str, Any]:
    """The keys that say how something failed; none where nothing did."""
    return {} if failure is None else {"error": str(failure), "exit_status": failure.exit_status}


def _measured(measurement: Measurement) -> dict[str, Any]:
    left_out = ("trace", "failure", "seen_rate", "mass_uncertainty", "second_mode")
    values = {name: value for name, value in vars(measurement).items() if name not in left_out}
    return values | {"mass_kg": measurement.mass, "mass_uncertainty_kg": measurement.mass_uncertainty}


def _device_document(prediction: Prediction, measurement: Measurement, channel: int) -> dict[str, Any]:
    """What the measurement beside the prediction tells of the device's mass, and of a hand that gives."""
    from hapsim.cli.compared import gives, oscillation_of, probable_mass

    second, is_extra = measurement.second_mode, gives(prediction, measurement)
    mass = None if is_extra else probable_mass(felt_on(prediction, channel), measurement)
    document = None
    if second is not None:
        frequency, ratio = oscillation_of(second.pole, measurement.trace.rate)
        document = {"frequency_hz": frequency, "damping_ratio": ratio, "share": second.share, "predicted": not is_extra}
    return {
        "dominant": measurement.dominant and not is_extra,
        "second_mode": document,
        "probable_mass_kg": None if mass is None else mass.mass,
        "probable_mass_uncertainty_kg": None if mass is None else mass.uncertainty,
    }


def lifetime_document(lifetime: Lifetime, grants: Sequence[PrivilegeResult] = ()) -> dict[str, Any]:
    """What `hapsim run` prints: the report of all sessions, and how often the device came back."""
    return (
        report_document(lifetime.report, grants)
        | {
            "reconnections": lifetime.reconnections,
            "interruptions": [asdict(one) for one in lifetime.interruptions],
            "records": list(map(str, lifetime.records)),
        }
        | failure_document(lifetime.failure)
    )


def report_document(report: Report, grants: Sequence[PrivilegeResult] = ()) -> dict[str, Any]:
    """One run; `grants`: what a real-time set-up asked for."""
    return asdict(report) | ({"realtime": [asdict(grant) for grant in grants]} if grants else {})


def felt_on(prediction: Prediction, channel: int | None) -> Felt | None:
    """The prediction for one channel (None: the scene's first), where the hand there is a system of its own."""
    for felt in prediction.felt:
        if channel in (None, felt.channel):
            return felt
    return None


def _felt(felt: Felt) -> dict[str, Any]:
    values = asdict(replace(felt, predictor=None))
    configuration = values.pop("configuration")
    values.pop("predictor")
    hand = {name: configuration[name] for name in ("mass", "friction", "delay", "hold", "sampling", "damper", "cutoff")}
    return values | hand | {"device_stiffness": configuration["stiffness"]} | robustness_of(felt)._asdict()


def plain(value: Any) -> Any:
    """Only what JSON has: complex numbers as [re, im], infinities and NaN as null."""
    if isinstance(value, dict):
        return {str(key): plain(entry) for key, entry in value.items()}
    if isinstance(value, complex):
        return [plain(value.real), plain(value.imag)]
    if isinstance(value, (list, tuple)) or hasattr(value, "tolist"):
        entries = value.tolist() if hasattr(value, "tolist") else value
        return [plain(entry) for entry in entries] if isinstance(entries, (list, tuple)) else plain(entries)
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value
