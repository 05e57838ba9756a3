"""Devices to be judged: one in plain Python, a process of its own, whole or with faults."""

from __future__ import annotations

import contextlib
import json
import subprocess
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest

DEVICE = Path(__file__).with_name("device.py")


@dataclass
class Served:
    """A device on a port; `last`: what it said of itself once it was stopped."""

    port: str
    last: dict[str, Any] = field(default_factory=dict)


@contextlib.contextmanager
def serve(*faults: str, **options: Any) -> Iterator[Served]:
    words = json.dumps(options | {"faults": list(faults)})
    command = [sys.executable, str(DEVICE), words]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        served = Served(process.stdout.readline().strip())
        try:
            yield served
        finally:
            out, _ = process.communicate()  # the end of its input stops it
    served.last = json.loads(out)


@pytest.fixture
def serving() -> Callable[..., contextlib.AbstractContextManager[Served]]:
    """Serves a device with these faults and options."""
    return serve
