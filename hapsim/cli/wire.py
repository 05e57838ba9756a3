"""What the wire costs, and what bounds the force when the host dies, as `hapsim check` tells them."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from rich.console import Console

from hapsim.number_format import duration
from hapsim.prediction import HostSilence, WireTime, host_silence
from hapsim.prediction.force_bounds import force_bounds, hidden_sign, refused_slew, run_bounds, slow_slew

if TYPE_CHECKING:
    from hapsim.prediction import Prediction
    from hapsim.scene import Scene


def show_wire(out: Console, prediction: Prediction, on_wire: Prediction | None) -> None:
    """What an exchange takes, and what that makes of the delay and of what the hand feels.

    `on_wire`: predicted for the delay that results; None where the wire costs one sample, or is saturated.
    """
    budget = prediction.wire_time
    verdict = "fits" if budget.fits else "[red]does not fit[/red]: a higher baud rate, or a lower rate"
    out.print(f"\n{_time(prediction)}: {verdict}. {_delay(budget)}")
    if on_wire is not None:
        out.print(_felt(prediction, on_wire))
    elif not budget.fits and not budget.is_saturated and _predicts(prediction):
        out.print(
            "[yellow]The predictor leads the state to where a force acts that is in time[/yellow]: what is felt with "
            "one that never is was not worked out. Use a faster wire."
        )
    if prediction.wire_of == "port":
        out.print(
            "This is counted for a UART. A device with USB of its own (CDC) ignores the baud rate and answers within a "
            "polling interval, 0.125 or 1 ms; the latency timer of a USB converter comes on top and is not counted."
        )
    elif prediction.wire_of == "none":
        out.print("That would be a UART at device.baud; the mock has a wire only where mock.baud gives it one.")


def show_silence(out: Console, rate: float) -> None:
    """What becomes of the force when the host dies."""
    silence: HostSilence = host_silence(rate)
    out.print(
        f"If the host dies, with clock: device and clock: host alike: the last force acts for at most "
        f"{_ms(silence.zero_force_after_s)} ({silence.time_to_live_samples} samples' time to live, and one more); "
        f"after {_ms(silence.latched_after_s)} (watchdog of {silence.watchdog_samples} samples, if the device allows "
        "it) the device latches: zero force until it is armed again."
    )


def show_force_bounds(out: Console, scene: Scene, prediction: Prediction) -> None:
    """What bounds the force in `hapsim run`, where the scene says its device is."""
    bounds = run_bounds(scene)
    slew = f"by at most {bounds.slew_limit:g} N/s" if math.isfinite(bounds.slew_limit) else "as fast as the scene asks"
    soft = "at once"
    if bounds.soft_start_s > 0.0:
        soft = f"along a ramp of {_ms(bounds.soft_start_s)} (what is asked for later comes without a ramp)"
    out.print(
        f"Force: at most {scene.device.force_limit:g} N; it changes {slew}, and what the scene asks for in the very "
        f"first sample comes {soft}. A run ends where the scene gives the hand more than {bounds.energy_limit:g} J, or "
        "goes on swinging or shaking at the force limit (what counts as that: hapsim/STABILITY.md, the guard of the "
        "energy)."
    )
    show_travel(out, scene)
    if scene.device.port is None and scene.device.clock != "lockstep":
        out.print(_behind_a_port(scene))
    if hidden := hidden_sign(scene, prediction):
        out.print(hidden)
    for warning in slew_warnings(scene, prediction):
        out.print(f"[yellow]Warning[/yellow]: {warning}")


def show_travel(out: Console, scene: Scene) -> None:
    """Within which limits the force is the scene's, and where its position 0 is; nothing where it names neither."""
    device, channels = scene.device, scene.channels
    limits, margins = device.travels(channels), device.travel_margins(channels)
    for c, origin in enumerate(device.origins(channels)):
        where = f" of channel {c}" if channels > 1 else ""
        if device.travel is not None:
            (least, most), stiffness = limits[c], device.force_limit / margins[c]
            out.print(
                f"Travel{where}: {least:g} to {most:g} m. Outside, the force fades to zero within {margins[c]:g} m (a "
                f"stiffness of up to {stiffness:.4g} N/m); a device that goes farther ends the run."
            )
        if device.origin is not None:
            zero = "the device is when it is armed" if origin is None else f"the device says {origin:g} m"
            out.print(f"Origin{where}: position 0 is where {zero}.")


def slew_warnings(scene: Scene, prediction: Prediction) -> list[str]:
    """What the slew limit takes from what is predicted without it; none where it takes nothing."""
    refused = refused_slew(scene)
    refused = f"{refused}: `hapsim run` refuses this scene." if refused else ""
    return [one for one in (refused, slow_slew(scene, prediction)) if one]


def _behind_a_port(scene: Scene) -> str:
    """How much of this is another with `--port`, where a hand may hold the device."""
    bounds = force_bounds(scene, in_hand=True)
    soft = f"along a ramp of {duration(bounds.soft_start_s)}" if bounds.soft_start_s > 0.0 else "at once"
    return (
        f"That is before the mock. Behind a port (`--port`) the force changes by at most {bounds.slew_limit:g} N/s, "
        f"and what the scene asks for in the very first sample comes {soft}."
    )


def _time(prediction: Prediction) -> str:
    """Its parts, and the period that they have to fit in."""
    budget = prediction.wire_time
    parts = []
    if budget.baud is not None:
        count = f"{budget.bytes_to_host} + {budget.bytes_to_device} bytes at {budget.baud} baud"
        parts.append(f"{count} take {_ms(budget.seconds)}")
    if budget.turnaround_s > 0.0:
        parts.append(f"the device's turnaround {_ms(budget.turnaround_s)}")
    if budget.host_work_s > 0.0:
        parts.append(f"the host's work {_ms(budget.host_work_s)}")
    share = budget.exchange_s / budget.period
    whole = f"{_ms(budget.exchange_s)} of the {_ms(budget.period)} period ({share:.0%})"
    return f"Wire, an exchange: {', '.join(parts)}; {whole}"


def _delay(budget: WireTime) -> str:
    if budget.is_saturated:
        longest = max(budget.bytes_to_host, budget.bytes_to_device)
        return (
            f"A frame of {longest} bytes alone takes longer than a period: frames queue up, and the delay has no end."
        )
    if budget.fits:
        samples = "One sample of delay"
        rate = f", up to {_below(budget.highest_rate_hz)} Hz" if math.isfinite(budget.highest_rate_hz) else ""
        return f"{samples}{rate}."
    speed = "" if budget.least_baud is None or budget.baud is None else f" or above {math.ceil(budget.least_baud)} baud"
    return (
        f"Every force misses its deadline: {budget.delay_samples} samples of delay. One sample below "
        f"{_below(budget.highest_rate_hz)} Hz{speed}."
    )


def _felt(prediction: Prediction, on_wire: Prediction) -> str:
    """What the hands feel at the delay that results, beside what they feel at the declared one."""
    sentences = []
    for declared, late in zip(prediction.felt, on_wire.felt, strict=True):
        delay = f"{late.configuration.delay:g} samples in place of {declared.configuration.delay:g}"
        if late.dominant:
            felt = f"k = {late.k:.6g} N/m, b = {late.b:.6g} N·s/m"
            instead = f" (instead of {declared.k:.6g}, {declared.b:.6g})" if declared.dominant else ""
        else:
            felt, instead = f"no spring and damper is equivalent: {late.reason}", ""
        sentences.append(f"With a delay of {delay}, at {late.name}: {felt}{instead}.")
    verdict = "stable" if on_wire.stable else "[red]unstable[/red]"
    return " ".join([*sentences, f"The scene is then {verdict} (spectral radius {on_wire.spectral_radius:.9g})."])


def _predicts(prediction: Prediction) -> bool:
    rendering = prediction.rendering
    return rendering is not None and rendering.kind is not None and rendering.kind.predicts


def _below(rate: float) -> str:
    """Rounded down."""
    return f"{math.floor(rate)}" if rate >= 10.0 else f"{rate:.3g}"


def _ms(seconds: float) -> str:
    return duration(seconds)
