"""Changes from several threads: who waits for whom."""

from __future__ import annotations

import sys
import threading
import time
from pathlib import Path

import numpy as np
import pytest

import hapsim
from hapsim.errors import UsageError
from hapsim.running.changes import LiveScene
from hapsim.scene import Scene

sys.path.insert(0, str(Path(__file__).parent))
from live_structures import BEGIN, LONE, OVER, running, scene_of


def test_a_set_does_not_wait_for_a_structure_that_waits(monkeypatch: pytest.MonkeyPatch) -> None:
    with running(scene_of(BEGIN), monkeypatch) as runner:
        over = threading.Event()
        live = LiveScene(scene_of(BEGIN), runner.loop, over.is_set)
        live.adopt(scene_of(BEGIN | LONE), OVER)  # the loop does not run: it is never through
        waits = threading.Thread(target=_adopt_in_vain, args=(live, scene_of(BEGIN)))
        waits.start()
        live.set({"nail": {"stiffness": 400.0}}, 0.0)
        assert waits.is_alive()
        over.set()
        waits.join()
        assert live.scene.modules["nail"].stiffness == 400.0  # type: ignore[attr-defined]


def _adopt_in_vain(live: LiveScene, scene: Scene) -> None:
    with pytest.raises(UsageError, match="the run is over"):
        live.adopt(scene, OVER)


def test_changes_follow_one_another() -> None:
    """A change of a scene waits until the change before it is complete."""
    with hapsim.start(scene_of(BEGIN)) as session:
        for n in range(10):
            session.adopt(scene_of(BEGIN | (LONE if n % 2 == 0 else {})), over=0.05)
        while session._loop.is_replacing:  # until then what is set goes together with the last of them
            time.sleep(0.001)
        session.set({"nail": {"stiffness": 400.0}})
        assert session.scene.modules["nail"].stiffness == 400.0  # type: ignore[attr-defined]
        ticks = session.progress().elapsed_s
        while session.progress().elapsed_s < ticks + 1.0:
            time.sleep(0.001)
        session.stop()
    assert session.trace.report.parameter_changes == 11
    np.testing.assert_array_equal(np.diff(session.trace.sample), 1)


def test_several_threads_change_it() -> None:
    def adopt(session: hapsim.Session, name: str) -> None:
        for n in range(5):
            session.adopt(scene_of(BEGIN | ({name: {"type": "mass", "mass": 0.1 + n}})), over=0.01)

    with hapsim.start(scene_of(BEGIN)) as session:
        threads = [threading.Thread(target=adopt, args=(session, f"by{i}")) for i in range(3)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        session.stop()
    np.testing.assert_array_equal(np.diff(session.trace.sample), 1)
    assert np.isfinite(session.trace.asked_force).all()


def test_who_waits_for_a_change_goes_on_when_the_run_is_over(monkeypatch: pytest.MonkeyPatch) -> None:
    with running(scene_of(BEGIN), monkeypatch) as runner:
        over = threading.Event()
        live = LiveScene(scene_of(BEGIN), runner.loop, over.is_set)
        live.adopt(scene_of(BEGIN | LONE), OVER)
        threading.Timer(0.05, over.set).start()
        with pytest.raises(UsageError, match="the run is over"):
            live.adopt(scene_of(BEGIN), OVER)
