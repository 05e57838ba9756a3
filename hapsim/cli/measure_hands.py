"""`hapsim measure --hands`: what several hands feel, of the scene and of each other."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from rich.markup import escape

from hapsim.cli.check_details import show_assumptions
from hapsim.cli.live import live_line
from hapsim.cli.options import DeviceOptions, ExcitationOptions, PictureOptions, RecordOptions
from hapsim.cli.output import document, spoken, stderr, stdout, table
from hapsim.cli.run import print_warnings, require_stable, with_mock
from hapsim.errors import UsageError
from hapsim.measuring.limits import require_device_point
from hapsim.measuring.measure_hands import measure_hands as measure
from hapsim.number_format import number, percent, plural, relative_difference, rounded
from hapsim.prediction import predict

if TYPE_CHECKING:
    from hapsim.measuring.measure_hands import HandsMeasurement
    from hapsim.prediction import FeltTogether


def measure_hands(
    device: DeviceOptions,
    excitation: ExcitationOptions,
    picture: PictureOptions,
    record: RecordOptions,
    unstable: bool,
    json: bool,
) -> None:
    """Rings each of the hands that are linked, and prints the matrices that it identifies beside the prediction."""
    others: dict[str, object] = {"--at": excitation.at, "--mass": excitation.mass or None, "--record": record.record}
    others |= {"--picture": picture.picture, "--data": picture.data, "--travel": excitation.travel}
    if refused := next((option for option, value in others.items() if value is not None), ""):
        raise UsageError(f"{refused} does not go with --hands, which rings every hand where it is")
    kind = device.kind()
    scene = with_mock(device.load(), kind)
    prediction = predict(scene, with_margins=False)
    channel = next(iter(scene.device_points.values())).channel if excitation.channel is None else excitation.channel
    require_device_point(scene, channel)
    one = next((part for part in prediction.together if channel in part.channels and len(part.names) > 1), None)
    if one is None:
        raise UsageError(f"--hands: the hand on channel {channel} is linked to no other; leave the option out")
    require_stable(device.scene, scene, prediction, unstable)
    warnings = print_warnings(scene, prediction)
    with live_line(stderr()) as tell:
        found = measure(scene, channels=one.channels, on_progress=tell, **excitation.for_runs(kind, unstable))
    if json:
        print(document({"scene": device.scene, "warnings": warnings, "hands": hands_document(one, found)}))
        return
    rows = [row for i in range(len(one.names)) for j in range(len(one.names)) for row in _rows(one, found, i, j)]
    title = f"What {' and '.join(map(escape, one.names))} feel, of the scene and of each other"
    stdout().print(table(title, ("", "predicted", "measured", "±", "off by"), rows))
    show_assumptions(stdout(), prediction.assumptions)
    if one.felt.reason:
        stdout().print(f"No pair is predicted, for {one.felt.reason}; measured are the motions with most energy.")
    stdout().print(
        f"Read from {plural(found.samples, 'sample')} of free motion; other motions had "
        f"{percent(found.others, 2)} of the energy. The uncertainty is without that of the masses."
    )


def _rows(one: FeltTogether, found: HandsMeasurement, i: int, j: int) -> list[tuple[str, ...]]:
    name = escape(one.names[i]) if i == j else f"{escape(one.names[i])} of {escape(one.names[j])}"
    sign, unit = 1.0 if i == j else -1.0, spoken(one.channels[i])
    rows: list[tuple[str, ...]] = []
    for what, of_unit in (("k", "N/m"), ("b", "N·s/m")):
        predicted, measured = (sign * float(getattr(side, what)[i, j]) for side in (one.felt, found))
        off = float(getattr(found, f"{what}_uncertainty")[i, j])
        shown = number(predicted) if one.felt.reason else rounded(predicted, off)
        cells = shown, rounded(measured, off), number(off, 1), relative_difference(measured, predicted)
        rows.append((f"{name}: {what}  {unit(of_unit)}", *cells))
    return rows


def hands_document(one: FeltTogether, found: HandsMeasurement) -> dict[str, Any]:
    """Returns the same for scripts; matrices by device points."""
    predicted = None if one.felt.reason else {"k": one.felt.k, "b": one.felt.b}
    names = ("k", "b", "k_uncertainty", "b_uncertainty", "poles", "others", "samples")
    measured = {name: getattr(found, name) for name in names}
    return {"device_points": one.names, "channels": found.channels, "predicted": predicted, "measured": measured}
