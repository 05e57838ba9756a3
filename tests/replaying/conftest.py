"""The helpers of the faults' tests, and the random scenes of the benches, can be imported."""

from __future__ import annotations

import sys
from pathlib import Path

HERE = Path(__file__).resolve().parent
for place in (HERE, HERE.parent / "faults", HERE.parents[1] / "tools" / "bench"):
    sys.path.append(str(place))
