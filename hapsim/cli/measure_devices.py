"""`hapsim measure` of hands that links tie across devices."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np
from rich.markup import escape

from hapsim.cli.before_arming import predict_devices
from hapsim.cli.command_options import require_units
from hapsim.cli.output import compared, document, show, stdout, table
from hapsim.documents import pick
from hapsim.measuring.measure_ports import measure_ports, tied_hands
from hapsim.number_format import percent, plural
from hapsim.prediction import predict

if TYPE_CHECKING:
    from hapsim.cli.measure_options import MeasureOptions
    from hapsim.measuring.measure_ports import PortsMeasurement
    from hapsim.prediction import Part
    from hapsim.scene import Scene

_Row = tuple[str, float, float, float, float]
_UNITS = {"k": "N/m", "b": "N·s/m"}


def measure_devices(asked: MeasureOptions, scene: Scene) -> None:
    """Pushes each of the hands that links tie across devices. Prints k and b beside the least and the largest that are
    predicted over the phases of the clocks."""
    hands = tied_hands(scene)
    for hand in hands:
        require_units(scene.units_at(hand), asked.push)
    part = next(one for one in predict(scene, with_margins=False).parts if set(hands) <= set(one.names))
    warnings = predict_devices(asked.scene, scene, asked.unstable)
    with asked.running() as options:
        found = measure_ports(scene, **options)
    rows = [*_rows(part, found)]
    if asked.json:
        keys = ("name", "least", "largest", "measured", "uncertainty")
        measured = pick(found.found, "k b k_uncertainty b_uncertainty samples others")
        hands_of = {"device_points": hands, "values": [dict(zip(keys, row, strict=True)) for row in rows]}
        print(document({"scene": asked.scene, "warnings": warnings, "hands": hands_of | {"measured": measured}}))
        return
    head = ("", "predicted, least", "largest", "measured", "±")
    title = f"What {' and '.join(map(escape, hands))} feel, over the phases of the clocks"
    stdout().print(table(title, head, [_as_text(row) for row in rows]))
    samples, others = plural(found.found.samples, "sample"), percent(found.found.others, 2)
    show(stdout(), [f"Fitted to {samples} of free motion. Other motions had {others} of the energy."])


def _rows(part: Part, found: PortsMeasurement) -> Iterator[_Row]:
    """Yields name, least and largest predicted value, measured value and its uncertainty, in SI units: of the tie of
    two hands that nothing else holds; else of each hand, and of each hand to each other one."""
    over = part.over_phases
    assert over is not None
    if over.tie is not None and len(found.hands) == 2:
        for what in _UNITS:
            least, largest = sorted(getattr(end, what) for end in over.tie)
            yield (f"between them: {what}", least, largest, *found.tie[what])
        return
    own = [part.names.index(name) for name in found.hands]
    for i, j in np.ndindex(found.found.k.shape):
        label, sign = (found.hands[i], 1.0) if i == j else (f"{found.hands[i]} of {found.hands[j]}", -1.0)
        for what in _UNITS:
            ends = sorted(sign * float(end[own[i], own[j]]) for end in getattr(over, what))
            value, unsure = (float(getattr(found.found, one)[i, j]) for one in (what, f"{what}_uncertainty"))
            yield (f"{label}: {what}", ends[0], ends[1], sign * value, unsure)


def _as_text(row: _Row) -> tuple[str, ...]:
    name, *ends, value, unsure = row
    least, largest = (compared(name, _UNITS[name[-1]], end, value, unsure) for end in ends)
    return least[0], least[1], largest[1], least[2], least[3]
