"""A record that was made in real time, replayed: every force is as it was, to the last bit."""

from __future__ import annotations

import os
import sys
from pathlib import Path

import pytest
from recorded_runs import random_scene, recorded

from hapsim.replaying.replay import Record, compare
from tests import thorough

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="pseudo-terminals of Linux")

# A few in the ordinary suite; HAPSIM_POINTS=50 takes fifty, for longer.
SCENES, SECONDS = thorough.points(1, 3), 1.0 if "HAPSIM_POINTS" in os.environ else 0.4


@pytest.mark.parametrize("seed", range(SCENES))
def test_random_scenes_with_changes_lost_positions_and_late_forces(seed: int, tmp_path: Path) -> None:
    paths = tmp_path / "a.trace", tmp_path / "b.trace"
    trace = recorded(random_scene(seed), *paths, seed, SECONDS)
    records = [Record(path) for path in paths if path.exists()]
    found = [compare(one, None, None, with_curves=False) for one in records]
    for one in found:
        assert one.difference is None, one.difference.what
    assert sum(one.changes for one in found) <= trace.report.parameter_changes
    assert trace.flags.any(), "nothing was lost or late"
    assert [note for note in records[0].notes if "marker" in note]
    assert records[-1].run.first_tick + found[-1].ticks == trace.report.ticks
    assert len(records) == 2 or trace.report.ending != "stopped", trace.report.ending
