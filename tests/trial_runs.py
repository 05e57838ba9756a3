"""Runs of sixty trials in virtual time, and what a record of them has."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hapsim.recording.stream import open_record
from hapsim.scene import Scene
from tests.one_hand import scene_of, touch

SAMPLES = 20  # of the beginning of a trial, 20 ms


def scene(clock: str = "lockstep") -> Scene:
    """Returns a hand on a spring, a mass that drifts at 0.1 m/s from 0.02 m on, and a number of 8 bits."""
    modules = {"touch": touch(200.0, 5.0), "drifter": {"type": "mass", "mass": 0.05, "position": 0.02, "velocity": 0.1}}
    outputs = {"code": {"bits": [8, 15]}, "led": {"bit": 3}}
    return scene_of(modules, outputs=outputs, device={"clock": clock}, mock={"initial": {"velocity": 0.1}})


def wait_beyond(stream: Any, sample: int) -> None:
    """Reads samples until one is behind this one."""
    for samples in stream:
        if samples.sample[-1] > sample:
            return


def columns_of(path: Path, *names: str) -> list[NDArray[Any]]:
    """Returns columns of a record's rows."""
    pieces = list(open_record(path).rows())
    return [np.concatenate([one[name] for one in pieces]) for name in names]
