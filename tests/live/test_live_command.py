"""`hapsim run --serve` as a program: what it prints, an edit of the scene's file, a device that goes and comes back."""

from __future__ import annotations

import re
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from live_clients import SCENE, Client
from websockets.sync.client import connect

from hapsim.cli.command_options import DeviceOptions
from hapsim.cli.live import LiveOptions
from hapsim.scene import parse_scene


def printed(program: Any, pattern: str) -> str:
    """Waits until standard error matches the pattern, and returns the match. The minute is for a machine that hangs."""
    give_up = time.monotonic() + 60.0
    while (found := re.search(pattern, program.err)) is None:
        assert time.monotonic() < give_up, program.err
        assert program.poll() is None, program.err
        time.sleep(0.01)
    return str(found[1])


def test_a_client_stays_through_edits_a_lost_device_and_to_the_end(
    start_hapsim: Callable[..., Any], tmp_path: Path
) -> None:
    scene, port = tmp_path / "scene.yaml", tmp_path / "port"
    scene.write_text(SCENE.replace("clock: host", "clock: device"), "utf-8")
    device = start_hapsim("mock", scene, "--link", port)
    while not port.exists():
        time.sleep(0.01)
    options = "--port", port, "--watch", "--reconnect", "--serve-at", "127.0.0.1:0", "--record-dir", tmp_path
    run = start_hapsim("run", scene, *options, "--reports", tmp_path)
    url = printed(run, r"Page: (http://\S+/)")
    with connect(f"ws{url[4:]}live", origin=url.rstrip("/")) as socket:  # type: ignore[arg-type]
        client = Client(socket)
        while (model := client.ask(type="get"))["phase"] != "running":
            pass
        assert (model["scene"], model["has_mock"], model["can_record"]) == ("scene.yaml", False, True)
        assert client.ask(type="set", values={"touch.stiffness": 1100})["type"] == "done"
        scene.write_text(scene.read_text("utf-8").replace("2000", "900"), "utf-8")
        while {one["name"]: one["value"] for one in model["parameters"]}["touch.stiffness"] != 900.0:
            model = client.ask(type="get")
        device.kill()
        client.event("lost")
        assert client.ask(type="get")["phase"] == "waiting"
        port.unlink()
        start_hapsim("mock", scene, "--link", port)
        client.event("reconnected")
        client.ask(type="subscribe")
        client.block()
        assert client.ask(type="stop")["type"] == "done"
        assert client.event("ended")["sentence"] == ""
        client.blocks_to_the_end()
        assert client.closed == (1001, "the run has ended")
    assert run.wait() == 0
    assert "Traceback" not in run.err


@pytest.mark.parametrize(
    ("device", "port", "live", "kind"),
    [
        ({}, None, {"serve": True}, "paced"),
        ({}, None, {"serve_at": ":0"}, "paced"),
        ({}, None, {"osc": True}, "paced"),
        ({"mock": True}, "/dev/ttyACM0", {"serve": True}, "paced"),
        ({}, None, {}, "auto"),
        ({}, "/dev/ttyACM0", {"serve": True}, "auto"),
        ({"transport": "terminal"}, None, {"serve": True}, "terminal"),
        ({"transport": "loopback"}, None, {"serve": True}, "loopback"),
    ],
)
def test_a_mock_that_is_served_is_in_memory_in_real_time(
    device: dict[str, Any], port: str | None, live: dict[str, Any], kind: str
) -> None:
    none = {"serve": False, "serve_at": None, "record_dir": None, "osc": False, "osc_at": None, "osc_from": None}
    scene = parse_scene(SCENE.replace("clock: host", f"port: {port}") if port else SCENE)
    options = DeviceOptions("scene.yaml", **{"port": None, "mock": False, "transport": None} | device)
    assert LiveOptions(**none | live).transport_kind(options, scene) == kind
