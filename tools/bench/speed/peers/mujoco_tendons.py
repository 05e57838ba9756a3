"""MuJoCo in a Python of its own: the work is done by `mujoco_worker.py`."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import asdict
from math import nan
from pathlib import Path
from typing import Any

from hapsim.speed_accuracy.strings import StringOfMasses

INTEGRATORS = ("Euler", "implicitfast", "RK4")
PYTHON_NAMED_BY = "HAPSIM_PEERS_PYTHON"
_BENCH = Path(__file__).resolve().parents[2]
_LIMIT_S = 300.0


class MuJoCo:
    """The string by one of MuJoCo's integrators."""

    precision = "double"

    def __init__(self, integrator: str) -> None:
        self._integrator = integrator
        self.name = f"MuJoCo {integrator}"
        self.preparation_s: float | None = None
        self.note = ""

    def available(self) -> str:
        python = _python()
        try:
            done = subprocess.run([python, "-c", "import mujoco"], capture_output=True, check=False)
        except OSError as error:
            return f"{PYTHON_NAMED_BY}: {error}"
        return (
            "" if done.returncode == 0 else f"{python} has no module mujoco; {PYTHON_NAMED_BY} may name one that has."
        )

    def cost(self, string: StringOfMasses, rate: float, rounds: int) -> list[float]:
        return list(self._ask(string, rate, do="cost", rounds=rounds) or [])

    def frequencies(self, string: StringOfMasses, rate: float, modes: Sequence[int]) -> list[float]:
        return list(self._ask(string, rate, do="frequencies", modes=list(modes)) or [nan for _ in modes])

    def _ask(self, string: StringOfMasses, rate: float, **job: Any) -> list[float] | None:
        job |= {"string": asdict(string), "rate": rate, "integrator": self._integrator}
        try:
            answer = _work(job)
        except subprocess.TimeoutExpired:
            self.preparation_s, self.note = None, f"gave up after {_LIMIT_S:.0f} s"
            return None
        self.preparation_s, self.note = answer["preparation_s"], answer["note"]
        return list(answer["values"])


def _work(job: dict[str, Any]) -> dict[str, Any]:
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(_BENCH), str(_BENCH.parents[1])])}
    command = [_python(), "-m", "speed.peers.mujoco_worker", json.dumps(job)]
    with tempfile.TemporaryDirectory() as place:  # where it keeps a log
        done = subprocess.run(
            command, capture_output=True, text=True, check=False, timeout=_LIMIT_S, env=environment, cwd=place
        )
    if done.returncode != 0:
        raise RuntimeError(f"MuJoCo's worker failed: {done.stderr.strip()[-500:]}")
    return dict(json.loads(done.stdout))


def _python() -> str:
    return os.environ.get(PYTHON_NAMED_BY) or sys.executable
