"""Time from a scene to its first tick: a string of 1000 masses, with and without compiled code in the cache.

`python -m speed.first_tick` measures once and prints JSON; imports are not counted.
"""

from __future__ import annotations

import itertools
import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

_ROOT = Path(__file__).resolve().parents[3]
_LIMIT_S = 600.0


def first_tick() -> dict[str, float]:
    """Seconds: of the scene, of its program, of the compiled tick and its first call."""
    import numpy as np

    from hapsim.cordis.offline import ticks
    from hapsim.cordis.program import compile_scene
    from hapsim.speed_accuracy.objects import scene_of
    from hapsim.speed_accuracy.strings import StringOfMasses, hand_link

    string = StringOfMasses.tuned(1000)
    times = [time.perf_counter()]
    scene = scene_of(string, "cordis", "double", 50_000.0, *hand_link(string))
    times.append(time.perf_counter())
    program = compile_scene(scene)
    times.append(time.perf_counter())
    ticks(program, *np.zeros((3, 1, scene.channels)), 1)
    times.append(time.perf_counter())
    parts = [after - before for before, after in itertools.pairwise(times)]
    return dict(zip(("scene", "program", "tick"), parts, strict=True)) | {"all": sum(parts)}


def cold_and_warm() -> tuple[dict[str, float], dict[str, float]]:
    """Measures in two processes, of which the first finds an empty cache."""
    with tempfile.TemporaryDirectory(prefix="hapsim-cold-") as cache:
        first, second = (_in_a_process(cache) for _ in range(2))
    return first, second


def _in_a_process(cache: str) -> dict[str, float]:
    paths = os.pathsep.join([str(_ROOT), str(_ROOT / "tools" / "bench")])
    environment = {**os.environ, "XDG_CACHE_HOME": cache, "PYTHONPATH": paths}
    command = [sys.executable, "-m", "speed.first_tick"]
    done = subprocess.run(command, capture_output=True, text=True, check=True, timeout=_LIMIT_S, env=environment)
    return dict(json.loads(done.stdout))


if __name__ == "__main__":
    print(json.dumps(first_tick()))
