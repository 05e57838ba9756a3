"""Hands in the plane on a field of force that the test chooses: the loop and its guards, without a scene's modules."""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
import pytest

from firmware_protocol.compiled import new_record
from hapsim.compiling.native import record_at
from hapsim.loop import guards
from hapsim.loop.hooks import Guard, Stage, hook, io_at, tick_at
from hapsim.scene import Scene

FIELD = np.dtype(
    [
        ("x", np.float64),  # N, a constant force
        ("y", np.float64),
        ("stiffness", np.float64),  # N/m, a spring to (0, 0)
        ("disc", np.float64),  # N/m, a disc about (0, 0),
        ("radius", np.float64),  # m, of this radius,
        ("damping", np.float64),  # N/m in a sample, with a damper
    ],
    align=True,
)
FIELD_AT = record_at(FIELD)


@hook
def add_field(field, tick):
    """Adds the field's force to the first hand."""
    field, io = FIELD_AT(field), io_at(tick_at(tick).io)
    x, y = io.measured[0], io.measured[1]
    away = math.sqrt(x * x + y * y)
    before = math.sqrt(io.before[0] * io.before[0] + io.before[1] * io.before[1])
    pressed = 0.0
    if 0.0 < away < field.radius:
        pressed = max(field.disc * (field.radius - away) - field.damping * (away - before), 0.0) / away
    io.asked[0] += field.x + (pressed - field.stiffness) * x
    io.asked[1] += field.y + (pressed - field.stiffness) * y
    return 0


def plane(device: dict[str, Any] | None = None, mock: dict[str, Any] | None = None) -> Scene:
    """A hand with x and y, and nothing else."""
    whole = {"mass": 0.2, "friction": 1.0, "clock": "lockstep"} | (device or {})
    modules = {"hand": {"type": "device", "channels": [0, 1]}}
    document = {"version": 1, "rate": 1000, "space": 2, "device": whole, "mock": mock or {}, "modules": modules}
    return Scene.model_validate(document)


@contextmanager
def field_of(x: float = 0.0, y: float = 0.0, **others: float) -> Iterator[Any]:
    """The scenes that are assembled meanwhile have this field; yields its record."""
    record = new_record(FIELD)
    for key, value in {"x": x, "y": y, **others}.items():
        record[key] = value
    with pytest.MonkeyPatch.context() as patch:
        field = Guard("field", FIELD, {Stage.ADD: add_field}, lambda *_: record)
        patch.setattr(guards, "GUARDS", (*guards.GUARDS, field))
        yield record
