"""The public API suffices for the benches and examples, and hapsim/USING.md describes all of it."""

from __future__ import annotations

import ast
import functools
import importlib
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

REPOSITORY = Path(__file__).resolve().parents[2]
PACKAGES = ("hapsim", "firmware_protocol")
PUBLIC_ROOMS = ("hapsim", "hapsim.theory", "hapsim.prediction", "hapsim.running", "hapsim.scene", "hapsim.errors")
ABOUT_ITSELF = {"__version__", "__file__", "__all__"}

ADDS_PEERS = "adds C, Faust, MuJoCo and SciPy to what `hapsim chart speed-accuracy` works out and draws"
TIMES_THE_TICK = "times the tick itself, without a loop and a device"
TIMES_THE_EXCHANGE = "times the compiled exchange itself, on a transport in memory of its own"
PLAYS_THE_DEVICE = "plays the device itself, to see when a run arms it"
FAULTS_IN_MEMORY = "puts the faults between the loop and the mock in memory, where no command does"
RUNS_AGAIN = "runs a loop and its mock again in the same memory, with a hand of its own on the mock's body"
A_GUARD_ALONE = "moves a hand of its own over one guard of the exchange, ten thousand times"
ASKS_THE_DEVICE = "asks the device for its own counters once the run is over"
WITHIN_THE_GUARDS = "draws what the guards allow a scene to hold"
TIMES_THE_MOCK = "times the mock's motion alone"
PUSHES_THE_MOCK = "pushes the mock, and goes on while its host stalls"
REPLAYS = "compares each row itself, and pushes the mock from sample to sample"
LOSES_FRAMES = "has a board of its own that loses frames and stalls"
INSIDE = {
    (f"tools/bench/{where}", room): why
    for where, why, rooms in (
        ("speed/", ADDS_PEERS, "hapsim.speed_accuracy hapsim.documents hapsim.chart"),
        ("speed/", TIMES_THE_TICK, "hapsim.cordis"),
        ("walls.py", TIMES_THE_TICK, "hapsim.cordis"),
        ("steadiness/", "writes its pictures and tables as `hapsim chart` does", "hapsim.chart.figure"),
        ("steadiness/in_memory.py", TIMES_THE_EXCHANGE, "firmware_protocol hapsim.compiling hapsim.device hapsim.loop"),
        ("steadiness/in_memory.py", TIMES_THE_EXCHANGE, "hapsim.running.assemble_loop hapsim.running.session_options"),
        ("steadiness/wakeups.py", "times the loop's sleep as it schedules itself", "hapsim.doctor.exchanges"),
        ("estimated_mass.py", PUSHES_THE_MOCK, "hapsim.device.mock.firmware hapsim.device.mock.record"),
        ("board_rough.py", LOSES_FRAMES, "firmware_protocol hapsim.loop"),
        ("board_faults.py", LOSES_FRAMES, "firmware_protocol"),
        ("board_faults.py", WITHIN_THE_GUARDS, "hapsim.loop.guards hapsim.running.session_options"),
        ("felt.py", "counts an error as the correction does", "hapsim.prediction.correction"),
        ("mutated_scenes.py", "calls the command in its own process, thousands of times", "hapsim.cli"),
        ("changes.py", FAULTS_IN_MEMORY, "hapsim.loop"),
        ("energy_guard.py", FAULTS_IN_MEMORY, "hapsim.loop firmware_protocol"),
        ("faults.py", FAULTS_IN_MEMORY, "hapsim.bringup.faults hapsim.cli.faults"),
        ("identification.py", "sees every run, for how far the device went in any of them", "hapsim.measuring"),
        ("inverted.py", FAULTS_IN_MEMORY, "hapsim.bringup.faults"),
        ("frozen_sensor.py", A_GUARD_ALONE, "firmware_protocol hapsim.compiling hapsim.loop hapsim.scales"),
        ("on_port.py", "has a motor known that no test has shown to be right", "hapsim.device.known_motors"),
        ("energy_guard.py", WITHIN_THE_GUARDS, "hapsim.scales"),
        ("wheels.py", WITHIN_THE_GUARDS, "hapsim.scales"),
        ("force_sensor.py", A_GUARD_ALONE, "firmware_protocol hapsim.device hapsim.loop hapsim.running"),
        ("sign.py", RUNS_AGAIN, "hapsim.compiling hapsim.device hapsim.loop hapsim.running"),
        ("mock_tick.py", TIMES_THE_MOCK, "hapsim.compiling hapsim.device"),
        ("soak.py", ASKS_THE_DEVICE, "firmware_protocol hapsim.device"),
        ("late_records.py", REPLAYS, "hapsim.replaying.replay hapsim.running.session_options"),
        ("lease.py", "serves a session whose program can hang, too", "hapsim.live"),
        ("lease.py", "finds in the record when each lease ran out", "hapsim.recording.stream"),
        ("start.py", PLAYS_THE_DEVICE, "hapsim.device.mock firmware_protocol"),
    )
    for room in rooms.split()
}
"""(where, what of the inside it uses on purpose): why."""

UNDERSCORED = {
    ("tools/bench/changes.py", "_loop"): "reads the tank of the loop, and whether a program is being replaced",
    ("tools/bench/changes.py", "_over"): "changes nothing in a session whose loop is over",
    ("tools/bench/energy_guard.py", "_loop"): "reads the account of the energy guard",
}
"""(where, what attribute with an underscore it reaches for on purpose): why."""


@functools.cache
def programs() -> dict[str, ast.Module]:
    """Python that shows how hapsim is used, by where it stands: the tools, and the examples of every page."""
    found = {path: path.read_text(encoding="utf-8") for path in (REPOSITORY / "tools").rglob("*.py")}
    folders = [REPOSITORY / name for name in (*PACKAGES, "configs", "tests", "tools")]
    pages = [*REPOSITORY.glob("*.md"), *(page for folder in folders for page in folder.rglob("*.md"))]
    for page in pages:
        examples = re.findall(r"^```python\n(.*?)^```", page.read_text(encoding="utf-8"), re.MULTILINE | re.DOTALL)
        found |= {page.with_name(f"{page.name}, example {i + 1}"): text for i, text in enumerate(examples)}
    return {path.relative_to(REPOSITORY).as_posix(): ast.parse(text) for path, text in found.items()}


def names_used(program: ast.Module) -> Iterator[tuple[str, str]]:
    """(room, name) of all of our packages that a program imports or reaches through `hapsim.`; "" for a whole room."""
    for node in ast.walk(program):
        if isinstance(node, ast.Import):
            yield from ((alias.name, "") for alias in node.names if alias.name.partition(".")[0] in PACKAGES)
        elif isinstance(node, ast.ImportFrom) and (node.module or "").partition(".")[0] in PACKAGES:
            yield from ((node.module or "", alias.name) for alias in node.names)
        elif isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name) and node.value.id in PACKAGES:
            yield node.value.id, node.attr


def is_public(room: str, name: str) -> bool:
    if room not in PUBLIC_ROOMS:
        return f"{room}.{name}" in PUBLIC_ROOMS
    return not name or name in ABOUT_ITSELF or name in public_names(room)


def public_names(room: str) -> set[str]:
    """Returns the names in a package's `__all__`; for scenes also those of its modules, and every type of module."""
    module = importlib.import_module(room)
    names = set(module.__all__)
    if room != "hapsim.scene":
        return names
    return names | public_names("hapsim.scene.modules") | {kind.__name__ for kind in module.MODULE_TYPES.values()}


def why_inside(where: str, room: str, name: str) -> tuple[str, str] | None:
    """The entry of INSIDE that allows it."""
    reached = f"{room}.{name}."
    return next((key for key in INSIDE if where.startswith(key[0]) and reached.startswith(f"{key[1]}.")), None)


def test_our_benches_and_examples_need_nothing_private() -> None:
    private, allowed = [], set()
    for where, program in programs().items():
        for room, name in names_used(program):
            if is_public(room, name):
                continue
            allowed.add(why_inside(where, room, name))
            if why_inside(where, room, name) is None:
                private.append(f"{where}: {name or 'import'} of {room}")
    assert private == []
    assert allowed == set(INSIDE)  # what needs the inside no longer is taken off the list


def test_the_search_for_private_names_finds_them() -> None:
    text = "import hapsim, hapsim.loop.ring\nfrom hapsim.theory.hand import poles\nhapsim.cordis.tick\nhapsim.run"
    found = [used for used in names_used(ast.parse(text)) if not is_public(*used)]
    assert found == [("hapsim.loop.ring", ""), ("hapsim.theory.hand", "poles"), ("hapsim", "cordis")]
    assert len(programs()) > 40
    assert sum(".md, example" in where for where in programs()) >= 2


def test_no_attribute_with_an_underscore_is_reached_for() -> None:
    """But one's own, and what every named tuple has."""
    reached = {
        (where, node.attr)
        for where, program in programs().items()
        for node in ast.walk(program)
        if isinstance(node, ast.Attribute) and re.match(r"_[a-z]", node.attr) and node.attr != "_replace"
        if not (isinstance(node.value, ast.Name) and node.value.id in ("self", "cls"))
    }
    assert reached == set(UNDERSCORED)


@pytest.mark.parametrize("room", PUBLIC_ROOMS)
def test_every_public_name_is_there_and_stands_in_the_manual(room: str) -> None:
    _, _, manual = (REPOSITORY / "hapsim" / "USING.md").read_text(encoding="utf-8").partition("## From Python")
    module = importlib.import_module(room)
    assert f"`{room}.`" in manual or f"`{room}`" in manual
    for name in module.__all__:
        assert getattr(module, name) is not None
        assert re.search(rf"`{name}[`(]", manual), f"{room}.{name} is not in hapsim/USING.md"
