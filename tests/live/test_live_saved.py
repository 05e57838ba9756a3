"""Clients save the scene: in its own file or under a plain name, nowhere else; from other machines only if asked."""

from __future__ import annotations

import json
import threading
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from live_clients import SOFT

from hapsim.live import web
from hapsim.live.web import Viewer
from hapsim.running import saving
from hapsim.scene import load_scene

TEXT = f"# Soft.\n{SOFT}"


@pytest.fixture
def path(tmp_path: Path) -> Path:
    (tmp_path / "own").mkdir()
    (tmp_path / "own" / "soft.yaml").write_text(TEXT, encoding="utf-8")
    return tmp_path / "own" / "soft.yaml"


def test_a_client_saves_live_values_and_all_clients_get_the_event(serve: Callable[..., Any], path: Path) -> None:
    served = serve(load_scene(path))
    with served.client() as client, served.client() as other:
        model = client.ask(type="get")
        assert (model["can_save"], model["file"]) == (True, "soft.yaml")
        client.ask(type="set", values={"touch.stiffness": 30.0, "mock.hand.force": 0.01})
        values = {one["name"]: (one["value"], one["saved"]) for one in client.ask(type="get")["parameters"]}
        assert values["touch.stiffness"] == (30.0, 20.0)
        assert values["touch.damping"] == (5.0, 5.0)
        assert values["mock.hand.force"] == (0.01, 0.0)
        assert client.ask(type="save") == {"type": "done", "id": 4, "file": str(path), "sample": None}
        assert other.event("saved")["sentence"] == str(path)
        saved = {one["name"]: one["saved"] for one in client.ask(type="get")["parameters"]}
        assert saved["touch.stiffness"] == 30.0
    expected = TEXT.replace("stiffness: 20", "stiffness: 30").replace(
        "velocity: 0.1}}", "velocity: 0.1}, hand: {force: 0.01}}"
    )
    assert path.read_text(encoding="utf-8") == expected


def test_a_drag_is_not_saved_and_ends_with_its_client(serve: Callable[..., Any], path: Path) -> None:
    served = serve(load_scene(path))
    before = load_scene(path).document["mock"]
    drag = {"mock.hand.stiffness": 200.0, "mock.hand.position": 0.01}

    def hand(client: Any) -> list[float]:
        values = {one["name"]: one["value"] for one in client.ask(type="get")["parameters"]}
        return [values[name] for name in drag]

    with served.client() as other:
        own = hand(other)
        with served.client() as client:
            for _ in range(2):  # the values of before are those before the first
                client.ask(type="set", values=drag, held=True)
            assert hand(client) == [200.0, 0.01]
            other.ask(type="save")
            assert load_scene(path).document["mock"] == before
            client.ask(type="set", values=drag, held=True)
            client.ask(type="release")
            assert any(hand(other) == own for _ in range(500))
            client.ask(type="set", values=drag, held=True)
        assert any(hand(other) == own for _ in range(500))


def test_a_name_is_a_plain_one_and_its_file_new(serve: Callable[..., Any], tmp_path: Path, path: Path) -> None:
    served = serve(load_scene("first_touch"))  # a shipped scene, that clients record and save in tmp_path
    (tmp_path / "link.yaml").symlink_to(path)
    with served.client() as client:
        assert client.ask(type="get")["file"] is None
        assert "name a file" in client.ask(type="save")["reason"]
        for name in ("../soft", "own/soft", str(path), "link", "..", "a" * 150):
            refused = client.ask(type="save", **{"as": name})
            assert refused["type"] == "rejected", name
        assert "the file exists" in client.ask(type="save", **{"as": "link.yaml"})["reason"]
        assert path.read_text(encoding="utf-8") == TEXT
        assert client.ask(type="save", **{"as": "mine"})["file"] == str(tmp_path / "mine.yaml")
        assert client.ask(type="get")["file"] == "mine.yaml"
        assert client.ask(type="save")["file"] == str(tmp_path / "mine.yaml")
        assert "a plain name" in _reason_of(client, {"type": "save", "as": 7})
        assert "save: found the key" in _reason_of(client, {"type": "save", "name": "x"})
    assert {one.name for one in tmp_path.iterdir()} == {"own", "link.yaml", "mine.yaml"}


def _reason_of(client: Any, message: dict[str, Any]) -> str:
    client.socket.send(json.dumps(message))
    return str(client.message(type="rejected")["reason"])


def test_a_client_that_goes_while_it_saves_leaves_a_whole_file(
    serve: Callable[..., Any], path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    served, write = serve(load_scene(path)), saving.write_text
    begun, gone, done = threading.Event(), threading.Event(), threading.Event()

    def write_late(*arguments: Any) -> None:
        begun.set()
        gone.wait(30)
        write(*arguments)
        done.set()

    monkeypatch.setattr(saving, "write_text", write_late)
    with served.client() as client:
        client.ask(type="set", values={"touch.stiffness": 30.0})
        client.send(type="save")
        assert begun.wait(30)
    gone.set()
    assert done.wait(30)
    assert path.read_text(encoding="utf-8") == TEXT.replace("stiffness: 20", "stiffness: 30")


def test_another_machine_saves_only_if_it_may(
    serve: Callable[..., Any], path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    view: Any = SimpleNamespace(others_save=False)
    for own, other, may in (
        ("127.0.0.1", "127.0.0.1", True),
        ("::1", "::1", True),
        ("192.168.0.2", "192.168.0.2", True),
        ("192.168.0.2", "192.168.0.3", False),
        ("::ffff:192.168.0.2", "::ffff:192.168.0.3", False),
    ):
        socket: Any = SimpleNamespace(local_address=(own, 7470), remote_address=(other, 50000))
        assert Viewer(view, socket)._can_save is may
        assert Viewer(SimpleNamespace(others_save=True), socket)._can_save  # type: ignore[arg-type]
    served = serve(load_scene(path))
    monkeypatch.setattr(web, "ip_of", lambda _: SimpleNamespace(is_loopback=False, one=object()))
    with served.client() as client:
        assert client.ask(type="get")["can_save"] is False
        assert "start hapsim with --save" in client.ask(type="save")["reason"]
        assert "start hapsim with --save" in client.ask(type="save", **{"as": "mine"})["reason"]
    assert path.read_text(encoding="utf-8") == TEXT
