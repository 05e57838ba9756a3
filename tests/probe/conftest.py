"""Devices to be judged: one in plain Python (device.py), in virtual time."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from hapsim.bringup.probe.probing import Wire
from hapsim.device.connection import Connection

sys.path.insert(0, str(Path(__file__).parent))
from virtual_line import VirtualLine


class Bench:
    """A wire to a device of these faults and options, in virtual time."""

    def __init__(self, *faults: str, **options: Any) -> None:
        self.line = VirtualLine(options | {"faults": list(faults)})
        self.device = self.line.device
        self.wire = Wire(Connection(self.line, "virtual device", close=lambda: None), self.line)


@pytest.fixture(scope="session")
def new_bench() -> Callable[..., Bench]:
    return Bench
