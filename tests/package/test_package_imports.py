"""Imports between packages run one way, without circles."""

from __future__ import annotations

import re
from functools import cache
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]

#: From those that stand on nothing to those that stand on all: a room imports itself, and rooms of lines above its own.
ORDER = (
    ("hapsim", "hapsim.errors", "hapsim.number_format", "hapsim.stopping", "firmware_protocol"),
    ("hapsim.dampers", "hapsim.laws", "hapsim.one_thread", "hapsim.units", "hapsim.whole_file"),
    ("hapsim.branch_law", "hapsim.scales"),
    ("hapsim.theory", "hapsim.scene", "hapsim.compiling"),
    ("hapsim.prediction", "hapsim.cordis"),
    ("hapsim.loop",),
    ("hapsim.device",),
    ("hapsim.recording",),
    ("hapsim.sound",),
    ("hapsim.running", "hapsim.bringup"),
    ("hapsim.curves", "hapsim.measuring", "hapsim.doctor", "hapsim.live", "hapsim.replaying"),
    ("hapsim.speed_accuracy", "hapsim.sweeping"),
    ("hapsim.chart",),
    ("hapsim.cli",),
    ("hapsim.__main__",),
)


def module_of(file: Path) -> str:
    return ".".join(file.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__")


FILES = {
    module_of(file): file for room in ("hapsim", "firmware_protocol") for file in sorted((ROOT / room).rglob("*.py"))
}


IMPORT = re.compile(r"^ *(?:from ([\w.]+) import (?:\(([^)]*)\)|(.*))|import (.*))$", re.M)
FOR_TYPES = re.compile(r"^( *)if TYPE_CHECKING:.*\n(?:\1 +.*\n|\n)+", re.M)


def imports(text: str) -> set[str]:
    """Returns the modules of ours that a file imports, in functions too. (To parse all files takes twenty times as
    long.)"""
    found = set()
    for module, in_brackets, on_line, modules in IMPORT.findall(text):
        for name in re.findall(r"([\w.]+)(?: as \w+)?", re.sub("#.*", "", in_brackets or on_line or modules)):
            inner = ".".join(filter(None, (module, name)))
            found.add(inner if inner in FILES else module)
    return found & FILES.keys()


@cache
def graphs() -> tuple[dict[str, set[str]], dict[str, set[str]]]:
    """Modules that each module imports, without and with those for a type alone."""
    texts = {module: file.read_text("utf-8") for module, file in FILES.items()}
    plain = {module: imports(FOR_TYPES.sub("", text)) - {module} for module, text in texts.items()}
    with_types = {  # the lists of public names import everything for type checkers
        module: plain[module] if FILES[module].name == "__init__.py" else imports(text) - {module}
        for module, text in texts.items()
    }
    return plain, with_types


def test_no_import_runs_in_a_circle_those_for_types_included() -> None:
    plain, with_types = graphs()
    assert sum(map(len, plain.values())) > len(plain) > 200
    try:
        TopologicalSorter(with_types).prepare()
    except CycleError as error:
        pytest.fail(" <- ".join(error.args[1]))


LEVELS = {room: number for number, line in enumerate(ORDER) for room in line}


def room_of(module: str) -> str:
    """The longest name in ORDER that a module's begins with."""
    return max((room for room in LEVELS if f"{module}.".startswith(f"{room}.")), key=len)


def test_a_room_imports_only_what_stands_below_it() -> None:
    wrong = [
        f"{module} imports {other}"
        for module, others in graphs()[0].items()
        for other in others
        if room_of(other) != room_of(module) and LEVELS[room_of(other)] >= LEVELS[room_of(module)]
    ]
    assert wrong == []


RUNS = ("branch", "measure", "measure_hands", "measure_plane", "pushes", "measure_impedance", "place")
RUNS += ("measure_admittance", "identify_device", "identify_servo", "identify_transmission", "measure_ports")
HAVE_SCENES_RUN = {f"hapsim.measuring.{name}" for name in RUNS}


@pytest.mark.parametrize(
    ("room", "never"),
    [
        ("hapsim.theory", "hapsim.cordis"),
        ("hapsim.measuring", "hapsim.theory"),
        ("hapsim.measuring", "hapsim.prediction"),
    ],
)
def test_prediction_and_measurement_are_two_roads(room: str, never: str) -> None:
    """Whatever the room imports, and what that imports in turn, or a comparison of the two would be worth nothing. Both
    roads may read `hapsim.laws`: each law's formula stands once more in the tests of links."""
    graph = graphs()[0]
    reached, ahead = set(), [module for module in graph if module.startswith(f"{room}.")]
    if room == "hapsim.measuring":  # these have a scene run; a run looks at its prediction before it takes a change;
        # and of the scene's geometry, place.py knows where it changes
        ahead = [module for module in ahead if module not in HAVE_SCENES_RUN]
    while ahead:
        module = ahead.pop()
        if module not in reached:
            reached.add(module)
            ahead.extend(graph[module])
    assert [module for module in reached if f"{module}.".startswith(f"{never}.")] == []


def test_of_a_prediction_measuring_knows_the_geometry_alone() -> None:
    graph = graphs()[0]
    known = {other for m in graph if m.startswith("hapsim.measuring.") for other in graph[m] if "prediction" in other}
    assert known == {"hapsim.prediction.characteristic", "hapsim.prediction.plane_geometry"}
