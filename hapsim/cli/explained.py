"""What a scene was compiled to, as text for people."""

from __future__ import annotations

import math

from rich.console import Console
from rich.table import Table

from hapsim.cordis.explain import Explanation


def show_explanation(out: Console, explanation: Explanation) -> None:
    """What `hapsim check --explain` adds."""
    table = Table(title="What the scene was compiled to", title_justify="left")
    for heading in ("part", "how many", "as"):
        table.add_column(heading, justify="right" if heading == "how many" else "left")
    for heading in ("bytes", "ns alone"):
        table.add_column(heading, justify="right")
    for part in explanation.parts:
        alone = "" if math.isnan(part.seconds) else f"{part.seconds * 1e9:.3g}"
        table.add_row(part.name, str(part.modules or ""), part.compiled_as, str(part.bytes), alone)
    out.print()
    out.print(table)
    share = explanation.seconds / explanation.period
    out.print(
        f"A tick takes {explanation.seconds * 1e9:.3g} ns, {share:.2g} of the sample period, here and now; "
        f"{explanation.points} points, {explanation.bytes} bytes, {explanation.precision} precision."
    )
    out.print(f"Of these the scene has none, and nothing was compiled: {', '.join(explanation.absent)}.")
