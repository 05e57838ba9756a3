from __future__ import annotations

import importlib.util
import sys
from pathlib import Path
from typing import Any

import pytest

_BENCH = Path(__file__).resolve().parents[2] / "tools" / "bench" / "estimated_mass.py"


@pytest.fixture(scope="session")
def bench() -> Any:
    """The devices that the figures are made with."""
    spec = importlib.util.spec_from_file_location("estimated_mass", _BENCH)
    assert spec is not None
    assert spec.loader is not None
    module = sys.modules["estimated_mass"] = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module
