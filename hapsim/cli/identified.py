"""What each way of `hapsim identify` shows and writes: the table of estimates, and the values in the scene's file."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING

from hapsim.cli import output
from hapsim.scene.rewrite import rewrite_device

if TYPE_CHECKING:
    from hapsim.measuring.device_fit import Estimate
    from hapsim.scene import Known, Scene

Declared = Mapping[str, float]
"""Values of the scene's `device`, in SI units, by name."""

Written = Mapping[str, "str | Known"]
"""Values to write into the scene's `device`, by key."""


def estimates_table(
    device: str,
    scene: Scene,
    channel: int,
    labels: Mapping[str, tuple[str, str]],
    declared: Declared,
    estimates: Mapping[str, Estimate],
    judge: Callable[[Estimate, float, str], str],
) -> output.Table:
    """Returns the table of declared values and estimates. `device`: what is identified. `labels`: words and unit of
    each estimate. `judge`: returns the last cell of an estimate, its declared value, and how far they are apart."""
    rows = []
    for name, one in estimates.items():
        known = declared.get(name, math.nan)
        *cells, off_by = output.compared(*labels[name], known, one.value, one.uncertainty, exact=True)
        if known == 0.0:
            off_by = output.output_units().number(one.value, labels[name][1], "+.2g")
        rows.append((*cells, judge(one, known, off_by)))
    title = f"{device} at {scene.hand_on(channel)}, channel {channel}"
    return output.table(title, ("", "declared", "found", "uncertainty", "off by"), rows)


def write_values(
    path: str, scene: Scene, channel: int, values: Written, why_not: str, stays: str, json: bool
) -> dict[str, str]:
    """Writes values into `device` of a scene's file, and prints what stands there now, and that another value `stays`;
    or `why_not`, without values. Returns the entries of the file."""
    in_file = rewrite_device(path, values, channel, scene.device_name) if values else {}
    if json:
        return in_file
    written = ", ".join(f"{name}: {value}" for name, value in in_file.items())
    output.print_line(
        f"Wrote into `device` of {path}: {written}.{stays}" if in_file else f"The file was not changed: {why_not}."
    )
    return in_file
