"""`hapsim measure --methods`: what a paper states about a rendered stiffness, as a paragraph and a table."""

from __future__ import annotations

import math
import platform
from collections.abc import Iterator
from datetime import UTC, datetime

from hapsim.holds import HOLDS
from hapsim.measuring.measure_trace import Measurement
from hapsim.number_format import number, plural
from hapsim.prediction import Prediction
from hapsim.running.recorded_run import versions_of_now

CITED = (
    "[1] J.-L. Florens, A. Voda, D. Urma: Dynamical issues in interactive representation of physical objects.\n"
    "hapsim/METHODS.md (`hapsim files` prints where) lists what else to report, with BibTeX."
)
_PACED = {"device": "paced by the device's own timer", "host": "paced by the host", "lockstep": "paced by the host"}


def paragraph(prediction: Prediction, measurement: Measurement, channel: int) -> str:
    """Returns a methods paragraph about the hand on a channel."""
    scene, trace, device = prediction.scene, measurement.trace, prediction.scene.device
    units, report = scene.units_of(channel), trace.report
    on = "a device" if device.port else "hapsim's simulated device, which no person held"
    clock = "in virtual time" if report.virtual_time else _PACED[device.clock]
    late = f"{report.deadline_misses} of {plural(report.ticks, 'force')} were late"
    return (
        f"Forces were rendered by hapsim {versions_of_now()['hapsim']} on {on}. It sampled positions at "
        f"{number(scene.rate)} Hz, {clock}, in steps of {units(trace.position_scale[channel], 'm', 3)}. A force acted "
        f"{number(device.delay)} sample period{'s' * (device.delay != 1.0)} after its position "
        f"({HOLDS[device.hold].meaning}). "
        f"{' '.join(_felt(prediction, measurement, channel))} In that run {late}."
    )


def _felt(prediction: Prediction, measurement: Measurement, channel: int) -> Iterator[str]:
    """Yields sentences on the desired, the felt and the predicted spring and damper."""
    scene, found, hand = prediction.scene, measurement, prediction.scene.hand_on(channel)
    units, part, correction = scene.units_of(channel), prediction.part_on(channel), scene.device.correction
    row = next((one for one in part.rows if one.hand == hand and not one.of), None) if part else None
    if row is not None and not math.isnan(row.desired_k):
        corrected = "without a correction" if correction == "none" else f"with the correction '{correction}'"
        asked = units.spring("kb", row.desired_k, row.desired_b)
        yield f"The scene asked for {asked}, the device's own spring and friction included, {corrected}."
    if not found.dominant:
        yield f"No single spring and damper describes what the hand '{hand}' felt."
        return
    each = (found.k, found.k_uncertainty, "N/m"), (found.b, found.b_uncertainty, "N·s/m")
    k, b = (f"{units.rounded(one, unsure, unit)} ± {units(unsure, unit, 1)}" for one, unsure, unit in each)
    yield (
        f"The hand '{hand}' felt k = {k} and b = {b} (standard uncertainties), identified from {found.samples} samples "
        f"of its motion after test pushes, for a mass of {units(found.mass, 'kg')}."
    )
    if row is not None and not math.isnan(row.k):
        yield f"Predicted without that run [1]: {units.spring('kb', row.k, row.b)}."


def rows(prediction: Prediction, measurement: Measurement, channel: int) -> list[tuple[str, str]]:
    """Returns what the paragraph leaves out, each as (name, value)."""
    scene, trace, versions = prediction.scene, measurement.trace, versions_of_now()
    units, report = scene.units_of(channel), measurement.trace.report
    late = report.lateness_s
    found = [
        ("software", ", ".join(f"{name} {one}" for name, one in versions.items() if name != "processor")),
        ("computer", f"{versions['processor']}, {platform.platform()}, Python {platform.python_version()}"),
        ("device", scene.device.port or "hapsim's mock"),
        ("law, hold, sampling", f"{scene.device.law}, {scene.device.hold}, {scene.device.sampling}"),
        ("force step, limit", f"{units(trace.force_scale[channel], 'N', 3)}, {units(scene.device.force_limit, 'N')}"),
        ("verdict", f"{prediction.verdict}, spectral radius {number(prediction.spectral_radius)}"),
        ("residual of the fit", units(measurement.residual_m, "m", 2)),
        ("rate kept", f"{number(report.rate_hz)} Hz"),
        ("clock", trace.clock.name if trace.clock else ""),
        ("time", f"{datetime.now(UTC):%Y-%m-%d}"),
    ]
    if late.p99 is not None and late.max is not None and not report.virtual_time:
        found.insert(-2, ("lateness, 99 % and largest", f"{1e6 * late.p99:.0f} µs, {1e6 * late.max:.0f} µs"))
    return found
