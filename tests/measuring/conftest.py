"""The helpers beside these tests, and those of the benches, can be imported."""

from __future__ import annotations

import sys
from pathlib import Path

HERE = Path(__file__).resolve().parent
for place in (HERE, HERE.parent, HERE.parent / "probe", HERE.parents[1] / "tools" / "bench"):
    sys.path.append(str(place))
