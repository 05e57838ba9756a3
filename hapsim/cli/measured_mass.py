"""`hapsim measure` of a scene in admittance: the mass and the damping that the hand feels."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from hapsim.cli import measure_remarks as remarks
from hapsim.cli import output
from hapsim.cli.before_arming import print_warnings, require_stable
from hapsim.cli.output import output_units
from hapsim.cli.run_command import show_report, show_run
from hapsim.documents import pick
from hapsim.measuring.measure import measure
from hapsim.measuring.measure_admittance import AdmittanceMeasurement, known_hand
from hapsim.prediction import predict
from hapsim.prediction.felt_mass import FeltMass, admittance_sentences
from hapsim.scene.admittance import AssumedHand

if TYPE_CHECKING:
    from hapsim.cli.measure_options import MeasureOptions
    from hapsim.scene import Scene


def measure_pair(asked: MeasureOptions, scene: Scene, channel: int) -> None:
    """Pushes the simulated mass, and prints the measured m and b beside the prediction for the same hand."""
    known_hand(scene, channel)
    prediction = predict(_in_these_hands(scene), with_margins=False)
    felt = next(one for one in prediction.felt_masses if one.channel == channel)
    require_stable(asked.scene, scene, prediction, asked.unstable)
    warnings = print_warnings(scene, prediction)
    with asked.running() as options:
        found: AdmittanceMeasurement = measure(scene, channel=channel, **options)
    report = found.trace.report
    asked.save([channel], found.trace)
    if asked.json:
        document: dict[str, Any] = {"scene": asked.scene, "warnings": warnings, "channel": channel}
        document |= {"predicted": felt, "measured": found} | pick(report, "*")
        print(output.document(document | output.failure_document(found.failure)))
    else:
        _show(scene, felt, found, channel, asked.push)
        (show_report if asked.explain else show_run)(output.stdout(), report)
        asked.print_files([channel])
        if found.failure is None:
            asked.print_next_run(scene, asked.unstable)
    output.exit_if_failed(found.failure)


def _in_these_hands(scene: Scene) -> Scene:
    """Returns the scene for the hands that hold the device while it is measured: on a port those that it assumes."""
    if scene.device.port is not None:
        return scene
    hand = scene.mock_device.hand
    held = AssumedHand(stiffness=hand.stiffness, damping=hand.damping, mass=hand.mass)
    return scene.model_copy(update={"device": scene.device.model_copy(update={"assumed_hand": held})})


def _show(scene: Scene, felt: FeltMass, found: AdmittanceMeasurement, channel: int, push: float | None) -> None:
    """Prints prediction beside measurement."""
    out, motion, units = output.stdout(), found.motion, scene.units_of(channel)
    where = " on the built-in mock" if scene.device.port is None else ""
    title = f"What the hand feels at {felt.name}, channel {channel},{where}".rstrip(",")
    mass, *masses = output.compared("m", "kg", felt.m, found.m, found.m_uncertainty)
    damping, *dampings = output.compared("b", "N·s/m", felt.b, found.b, found.b_uncertainty)
    rows = (
        (mass, output_units().number(felt.mass, "kg"), *masses),
        (damping, output_units().number(felt.damping, "N·s/m"), *dampings),
    )
    out.print(output.table(title, ("", "simulated", "predicted", "measured", "±", "off by"), rows))
    held = f"{units(found.hand.stiffness, 'N/m', 'g')} and {units(found.hand.damping, 'N·s/m', 'g')}"
    own = f" The scene's links add {units(found.scene_stiffness, 'N/m', '.6g')}." * (found.scene_stiffness != 0.0)
    out.print(f"In a hand of {held} ({found.hand.origin}).{own}")
    for sentence in (*admittance_sentences(felt, units), *remarks.smaller_push(push, found.push_n)):
        out.print(sentence)
    if not found.dominant and found.reason != felt.reason:
        out.print(f"The motion is not that of a mass in this hand: {found.reason}.")
    residual = units(motion.residual_m, "m", ".2g")
    out.print(f"Fitted to {motion.samples} samples with {motion.order} poles; the residual is {residual}.")
