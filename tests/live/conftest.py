"""A running scene that is served."""

from __future__ import annotations

import contextlib
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

sys.path.insert(0, str(Path(__file__).parent))


@pytest.fixture
def serve(tmp_path: Path) -> Iterator[Callable[..., Any]]:
    """Runs a scene on the mock and serves it; ends both with the test."""
    from live_clients import serving

    with contextlib.ExitStack() as stack:
        yield lambda *scene, **options: stack.enter_context(serving(*scene, record_dir=tmp_path, **options))


@pytest.fixture(scope="module")
def shared() -> Iterator[Any]:
    """One scene for the tests of a file that leave it as it is."""
    from live_clients import SOFT, serving

    with serving(SOFT) as served:
        yield served


@pytest.fixture(scope="session")
def browser() -> Iterator[Any]:
    """Chromium, for all tests of a worker."""
    from live_page import chromium

    with chromium() as driver:
        yield driver


@pytest.fixture
def page(browser: Any, serve: Callable[..., Any]) -> Any:
    """The page of a scene."""
    from live_page import Page

    return Page(browser, serve())
