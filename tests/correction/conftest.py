from __future__ import annotations

from typing import Any

import pytest

from tests.loaded_files import BENCHES, module_of


@pytest.fixture(scope="session")
def bench() -> Any:
    """The devices that the figures are made with."""
    return module_of(BENCHES / "estimated_mass.py")
