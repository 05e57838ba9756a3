"""A scene that falls silent does not become slow."""

from __future__ import annotations

import platform
import threading

import pytest

from hapsim.compiled import jit
from hapsim.loop.denormals import flush_denormals


@jit
def product_after_flushing(a, b):
    flush_denormals()
    return a * b


@jit
def product(a, b):
    return a * b


@pytest.mark.skipif(platform.machine() not in ("x86_64", "AMD64"), reason="another processor's mode is left alone")
def test_what_is_too_small_becomes_zero_in_the_thread_that_asks_and_in_no_other() -> None:
    found: list[float] = []

    def work() -> None:
        found.extend([product(1e-300, 1e-10), product_after_flushing(1e-300, 1e-10), product(1e-300, 1e-10)])

    thread = threading.Thread(target=work)
    thread.start()
    thread.join()
    assert found == [1e-310, 0.0, 0.0]
    assert product(1e-300, 1e-10) == 1e-310
