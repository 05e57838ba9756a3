"""A scene that is predicted unstable is not armed, and a running one does not become one, unless that is asked for."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

import hapsim as public
from hapsim.errors import UsageError
from hapsim.running.watch import WatchedFile

Hapsim = Callable[..., Any]
SceneFile = Callable[..., Path]

SOFT, STIFF = {"touch": {"stiffness": 500.0}}, {"touch": {"stiffness": 50000.0}}


@pytest.mark.parametrize("words", [["run"], ["measure"], ["measure", "--impedance"]])
@pytest.mark.parametrize("port", [{}, {"port": "/dev/ttyNOPE7"}])
def test_an_unstable_scene_is_refused_before_a_port_is_opened(
    hapsim: Hapsim, scene_file: SceneFile, words: list[str], port: dict[str, str]
) -> None:
    path = scene_file("unstable", **port)
    refusal = hapsim(*words, path, "--json").refusal
    assert refusal.startswith(f"{path}: not armed: the scene is predicted unstable (spectral radius 1.")
    for told in ("the motion of hand grows by", "hand is stable below 0.0", "With --unstable it runs"):
        assert told in refusal


def test_an_unstable_scene_runs_where_it_is_asked_for(hapsim: Hapsim, scene_file: SceneFile) -> None:
    answer = hapsim("run", scene_file("unstable"), "--duration", 0.05, "--json", "--unstable")
    assert (answer.status, answer.document["ticks"]) == (0, 50)
    assert "Warning: the scene is predicted unstable" in answer.err


def test_python_is_refused_it_too_with_unstable_false(scene_file: SceneFile) -> None:
    scene = public.load_scene(scene_file("unstable"))
    with pytest.raises(UsageError, match="not armed: the scene is predicted unstable"):
        public.run(scene, duration=0.05, unstable=False)
    assert public.run(scene, duration=0.05).report.ticks == 50


@pytest.mark.parametrize(("unstable", "set_refused", "file_refused"), [(False, 1, 1), (None, 0, 1), (True, 0, 0)])
def test_a_running_scene_becomes_unstable_only_where_it_may(
    scene_file: SceneFile, unstable: bool | None, set_refused: bool, file_refused: bool
) -> None:
    path = scene_file("spring")
    with public.start(public.load_scene(path), unstable=unstable) as session:
        if set_refused:
            with pytest.raises(UsageError, match="the scene is predicted unstable: the motion of hand grows"):
                session.set(STIFF)
            assert session.scene == public.load_scene(path)
        else:
            session.set(STIFF)
        session.set(SOFT)  # which is stable, wherever it comes from
        file = WatchedFile(str(path))
        path.write_text(
            path.read_text(encoding="utf-8").replace("stiffness: 1000.0", "stiffness: 50000.0"), encoding="utf-8"
        )
        os.utime(path, ns=(1, 1))
        news = file.check(session)
        assert news is not None
        assert ("predicted unstable" in news.refused, bool(news.changed)) == (bool(file_refused), not file_refused)
