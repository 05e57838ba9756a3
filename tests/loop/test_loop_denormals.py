"""A scene that falls silent does not become slow, and the rest of the program keeps its small numbers."""

from __future__ import annotations

import platform

import numpy as np
import pytest

import hapsim
from hapsim.compiling import entry
from hapsim.cordis.program import numbers_of, positions_of
from hapsim.loop.system import flush_denormals, restore_denormals
from hapsim.running import Session
from hapsim.scene import Scene
from tests.one_hand import scene_of

pytestmark = pytest.mark.skipif(
    platform.machine() not in ("x86_64", "AMD64"), reason="another processor's mode is left alone"
)

SMALLEST = np.finfo(np.float64).tiny
RATE, MASS = 1000.0, 0.1


@entry
def product_while_flushed(a, b):
    mode = flush_denormals()
    flushed = a * b
    restore_denormals(mode)
    return flushed


@entry
def product(a, b):
    return a * b


def test_what_is_too_small_becomes_zero_until_the_mode_is_put_back() -> None:
    assert [product(1e-300, 1e-10), product_while_flushed(1e-300, 1e-10), product(1e-300, 1e-10)] == [1e-310, 0, 1e-310]


def falling_silent() -> Scene:
    """A cell whose two poles are 0.9, beside a hand: after 7000 samples it would be at 1e-320 of where it began."""
    a, b = 0.01, 0.19  # T²/m K, T/m B
    cell = {"type": "cell", "mass": MASS, "stiffness": a * MASS * RATE**2, "damping": b * MASS * RATE, "position": 1.0}
    return scene_of({"ball": cell})


def test_a_running_scene_has_no_such_numbers_and_leaves_its_thread_as_it_was(monkeypatch: pytest.MonkeyPatch) -> None:
    products: list[float] = []
    work = Session._run_loop

    def work_and_multiply(session: Session) -> None:
        work(session)
        products.append(product(1e-300, 1e-10))

    monkeypatch.setattr(Session, "_run_loop", work_and_multiply)
    with hapsim.start(falling_silent(), duration=7.0) as session:
        assert session.wait(60.0)
    position = positions_of(session._loop.program)[0][numbers_of(session.scene)["ball"]]
    assert position == 0.0 or abs(position) >= SMALLEST
    assert abs(position) < 1e-300
    assert products == [1e-310]
