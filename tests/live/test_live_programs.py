"""The files for Pd, SuperCollider and Max: what these programs set the scene gets, and what it has they read."""

from __future__ import annotations

import contextlib
import json
import os
import re
import shutil
import socket
import subprocess
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from live_clients import Served, serving

import hapsim
from hapsim.live.access import address_of
from hapsim.live.osc import OscView
from hapsim.live.server import Server

FILES = Path(hapsim.__file__).parent / "configs" / "live"
SCENE = (FILES.parent / "first_touch.yaml").read_text("utf-8")
WAIT_S = 60.0  # for a program to start on a busy machine
VALUES = [1500.0, 1234.5, 800.25]


class Program:
    """A program that runs, and the lines that it prints."""

    def __init__(self, process: subprocess.Popen[str]) -> None:
        self.lines: list[str] = []
        self._out = process.stdout
        threading.Thread(target=self._read, daemon=True).start()

    def _read(self) -> None:
        assert self._out is not None
        for line in self._out:
            self.lines.append(line.strip())

    def latest(self, name: str) -> float | None:
        """The value that it printed last under this name."""
        found = [one for line in self.lines[-50:] if (one := re.fullmatch(rf"{name}:? (\S+)", line))]
        return float(found[-1][1]) if found else None


@contextlib.contextmanager
def program(name: str, *arguments: str, package: str) -> Iterator[Program]:
    if shutil.which(name) is None:
        pytest.skip(f"{name} is not installed (Debian: {package})")
    # Without these sclang does not run headless, nor as root.
    environment = os.environ | {"QTWEBENGINE_DISABLE_SANDBOX": "1", "QT_QPA_PLATFORM": "offscreen"}
    pipe = subprocess.PIPE
    command = [name, *arguments]
    with subprocess.Popen(
        command, env=environment, stdin=pipe, stdout=pipe, stderr=subprocess.STDOUT, text=True
    ) as process:
        try:
            yield Program(process)
        finally:
            process.kill()


@pytest.fixture(scope="module")
def answering() -> Iterator[tuple[Served, int]]:
    with serving(SCENE) as served:
        view = OscView(served.hub, address_of("--osc-at", ":0", 0), (), served.warnings.append)
        server = Server([view], served.warnings.append)
        server.start()
        yield served, view.address.port
        server.close()


def with_ports(name: str, osc: int) -> str:
    """A shipped file, with other ports than those that everybody uses."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
        free.bind(("127.0.0.1", 0))
        return (FILES / name).read_text("utf-8").replace("7471", str(osc)).replace("7479", str(free.getsockname()[1]))


def until(holds: Callable[[], Any], about: Program) -> Any:
    give_up = time.monotonic() + WAIT_S
    while not (found := holds()):
        assert time.monotonic() < give_up, "\n".join(about.lines[-20:])
        time.sleep(0.02)
    return found


def require_that_it_sets_and_reads(running: Program, served: Served, send: Callable[[str, float], None]) -> None:
    """`tell`: has the program set the stiffness, then ask for it. It prints "is VALUE" and "position VALUE"."""
    session = served.session
    for value in VALUES:
        until(lambda: send("stiffness", value) or session.parameters["touch.stiffness"].value == value, running)  # noqa: B023
        until(lambda: send("ask", 0.0) or running.latest("is") == value, running)  # noqa: B023
    session.set({"mock.hand": {"stiffness": 300.0, "damping": 3.0, "position": 0.004}})

    def is_read_at_rest() -> bool:
        """Returns whether the hand is at rest and its position is current: the velocity is also zero at each turn of a
        swing."""
        now = session.state()
        held = abs(now.velocity[0]) < 1e-6 and now.position[0] > 1e-4
        return held and running.latest("position") == pytest.approx(float(now.position[0]), rel=1e-4)

    until(is_read_at_rest, running)
    session.set({"mock.hand": {"stiffness": 0.0, "damping": 0.0, "position": 0.0}})


def test_pd_sets_and_reads_a_running_scene(answering: tuple[Served, int], tmp_path: Path) -> None:
    served, port = answering
    (tmp_path / "hapsim.pd").write_text(with_ports("hapsim.pd", port), "utf-8")
    control = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    control.bind(("127.0.0.1", 0))
    at = control.getsockname()[1]
    control.close()
    (tmp_path / "test.pd").write_text(
        "#N canvas 0 0 400 300 12;\n"
        f"#X obj 10 10 netreceive -u {at};\n"
        "#X obj 10 40 route stiffness ask;\n"
        "#X obj 10 70 s hapsim-stiffness;\n"
        "#X obj 100 70 s hapsim-ask;\n"
        "#X obj 10 130 r hapsim-stiffness-is;\n"
        "#X obj 10 160 print is;\n"
        "#X obj 150 130 r hapsim-position;\n"
        "#X obj 150 160 print position;\n"
        "#X connect 0 0 1 0;\n#X connect 1 0 2 0;\n#X connect 1 1 3 0;\n#X connect 4 0 5 0;\n#X connect 6 0 7 0;\n",
        "utf-8",
    )
    files = [word for name in ("hapsim.pd", "test.pd") for word in ("-open", str(tmp_path / name))]
    out = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    with out, program("pd", "-nogui", "-noaudio", "-stderr", *files, package="puredata-core") as running:

        def send(what: str, value: float) -> None:
            out.sendto(f"{what} {value};\n".encode(), ("127.0.0.1", at))
            time.sleep(0.2)

        require_that_it_sets_and_reads(running, served, send)


@pytest.mark.thorough
def test_supercollider_sets_and_reads_a_running_scene(answering: tuple[Served, int], tmp_path: Path) -> None:
    served, port = answering
    shipped, own, commands = tmp_path / "hapsim.scd", tmp_path / "test.scd", tmp_path / "commands"
    shipped.write_text(with_ports("hapsim.scd", port), "utf-8")
    commands.write_text("", "utf-8")
    own.write_text(
        f'"{shipped}".load;\n'
        "Routine { var last; loop {\n"
        f'  var text = File.readAllString("{commands}"), words = text.split($ );\n'
        "  if ((words.size == 3) and: { text != last }) { last = text;\n"
        '    if (words[1] == "ask") { ~ask.("touch/stiffness", { |value| ("is " ++ value).postln }) }\n'
        '      { ~set.("touch/" ++ words[1], words[2].asFloat) } };\n'
        '  ~position !? { ("position " ++ ~position[0]).postln };\n'
        "  0.05.wait } }.play(AppClock);\n",
        "utf-8",
    )
    with program("sclang", str(own), package="supercollider-language") as running:
        number = iter(range(1_000_000))

        def send(what: str, value: float) -> None:
            (tmp_path / "next").write_text(f"{next(number)} {what} {value}", "utf-8")
            (tmp_path / "next").replace(commands)
            time.sleep(0.2)

        require_that_it_sets_and_reads(running, served, send)


def test_max_is_given_addresses_that_the_scene_has(answering: tuple[Served, int]) -> None:
    served, _ = answering
    patcher = json.loads((FILES / "hapsim.maxpat").read_text("utf-8"))["patcher"]
    boxes = {one["box"]["id"]: one["box"] for one in patcher["boxes"]}
    for one in patcher["lines"]:
        (source, outlet), (target, inlet) = one["patchline"]["source"], one["patchline"]["destination"]
        assert outlet < boxes[source]["numoutlets"]
        assert inlet < boxes[target]["numinlets"]
    texts = " ".join(box.get("text", "") for box in boxes.values())
    known = {f"/hapsim/{name.replace('.', '/')}" for name in served.session.parameters}
    known |= {f"/hapsim/{name}" for name in ("subscribe", "stop", "position", "velocity", "force", "error")}
    used = set(re.findall(r"/hapsim/\S+", texts))
    assert used <= known
    assert {"/hapsim/touch/stiffness", "/hapsim/force"} <= used
