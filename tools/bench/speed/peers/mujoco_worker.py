"""One job for MuJoCo: `python -m speed.peers.mujoco_worker JOB`, a JSON document; another one is printed.

Wants numpy and mujoco of its Python, nothing else.
"""

from __future__ import annotations

import json
import sys
import time
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from hapsim.speed_accuracy.strings import StringOfMasses, cost_of, frequencies_of, project

_OFF = (
    *("constraint", "equality", "frictionloss", "limit", "contact", "warmstart", "filterparent", "midphase"),
    *("gravity", "clampctrl", "actuation", "sensor", "autoreset"),
)


def model_text(string: StringOfMasses, rate: float, integrator: str) -> str:
    """The string in MuJoCo's XML: every mass a body of the world with one slide joint, every link a fixed tendon."""
    off = " ".join(f'{flag}="disable"' for flag in _OFF)
    bodies = "".join(
        f'<body><joint name="x{i}" type="slide" axis="0 0 1"/>'
        f'<inertial pos="0 0 0" mass="{string.mass!r}" diaginertia="1e-9 1e-9 1e-9"/></body>'
        for i in range(string.masses)
    )
    tendons = "".join(_tendon(string, i) for i in range(string.masses + 1))
    return (
        f'<mujoco><option timestep="{1.0 / rate!r}" integrator="{integrator}"><flag {off}/></option>'
        f"<worldbody>{bodies}</worldbody><tendon>{tendons}</tendon></mujoco>"
    )


def _tendon(string: StringOfMasses, link: int) -> str:
    """Returns a tendon. Its length is the distance from the mass before it to the mass after it; a string's end counts
    as 0."""
    ends = [(link - 1, -1), (link, 1)]
    joints = "".join(f'<joint joint="x{mass}" coef="{sign}"/>' for mass, sign in ends if 0 <= mass < string.masses)
    return f'<fixed stiffness="{string.stiffness!r}" damping="{string.damping!r}" springlength="0 0">{joints}</fixed>'


class RunningMuJoCo:
    """The model, its state, and the seconds that it took to make them."""

    def __init__(self, string: StringOfMasses, rate: float, integrator: str) -> None:
        begin = time.perf_counter()
        self._model = mujoco.MjModel.from_xml_string(model_text(string, rate, integrator))
        self._data = mujoco.MjData(self._model)
        self.preparation_s = time.perf_counter() - begin

    def start_in(self, displacement: NDArray[np.float64]) -> None:
        """Puts the masses at `displacement` in m, shape (N,), at rest."""
        mujoco.mj_resetData(self._model, self._data)
        self._data.qpos[:] = displacement

    def advance(self, samples: int) -> None:
        mujoco.mj_step(self._model, self._data, nstep=samples)

    def record(self, shape: NDArray[np.float64], samples: int) -> NDArray[np.float64]:
        """The motion along `shape`, released in it at rest."""
        self.start_in(shape)
        motion = np.empty(samples)
        for n in range(samples):
            self.advance(1)
            motion[n] = project(self._data.qpos, shape)
        return motion


def _do(job: dict[str, Any]) -> dict[str, Any]:
    string, rate = StringOfMasses(**job["string"]), job["rate"]
    run = RunningMuJoCo(string, rate, job["integrator"])
    if job["do"] == "cost":
        run.start_in(string.plucked())
        values = cost_of(run.advance, rate, job["rounds"])
    else:
        values = frequencies_of(run.record, string, rate, job["modes"])
    return {"values": values, "preparation_s": run.preparation_s, "note": f"MuJoCo {mujoco.__version__}"}


if __name__ == "__main__":
    print(json.dumps(_do(json.loads(sys.argv[1]))), flush=True)
