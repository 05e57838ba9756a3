"""Every option of a command in each of its modes: it is refused in a sentence, or it changes the result."""

from __future__ import annotations

import re
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hapsim.chart import felt_chart
from hapsim.cli.command_line import ChartCommands, Commands
from hapsim.cli.command_options import PictureOptions
from hapsim.cli.option_modes import COUPLED, IN_ADMITTANCE, IN_PLANE, MODES, SEVERAL, refusal, word_of

pytestmark = pytest.mark.usefixtures("coarse_planes")

HEAD = "version: 1\nrate: 1000\n"
DEVICE = "device: {mass: 0.2, friction: 1, clock: lockstepPORT}\nmock: {hand: {stiffness: 300}}\nmodules:\n"
HAND, WALL = "  hand: {type: device, channel: 0}\n", "  wall: {type: ground}\n"
LINK = "{{type: viscoelastic, between: [{}], stiffness: STIFF, damping: 5}}\n"
SCENES = {
    "lone": HEAD + DEVICE + HAND + WALL + "  touch: " + LINK.format("hand, wall"),
    "contact": f"{HEAD}{DEVICE}{HAND}{WALL}  touch: {{type: buffer, between: [hand, wall], stiffness: 500}}\n",
    "linked": f"{HEAD}{DEVICE}{HAND}  other: {{type: device, channel: 1}}\n  touch: {LINK.format('hand, other')}",
    "masses": f"{HEAD}{DEVICE}{HAND}{WALL}  ball: {{type: mass, mass: 0.05}}\n"
    f"  touch: {LINK.format('hand, ball')}  hold: {LINK.format('ball, wall')}",
    "simulated": HEAD
    + "device: {mode: admittance, simulated_mass: 0.2, simulated_damping: 5, assumed_hand: {stiffness: STIFF},"
    " clock: lockstepPORT}\nmock: {hand: {stiffness: STIFF}}\nmodules:\n" + HAND,
    "ring": f"{HEAD}space: 2\n{DEVICE}  hand: {{type: device, channels: [0, 1]}}\n"
    "  post: {type: ground, position: [-21 mm, 0]}\n"
    "  ring: {type: shape, between: [hand, post], form: {disc: 20 mm}, side: inside, stiffness: STIFF, damping: 5}\n",
    "several": f"{HEAD}devices:\n  left: {{mass: 0.2, friction: 1, clock: lockstepPORT}}\n"
    "  right: {mass: 0.2, friction: 2, clock: lockstep}\n"
    "modules:\n  hand: {type: device, of: left, channel: 0}\n  other: {type: device, of: right, channel: 0}\n"
    f"  touch: {LINK.format('hand, other')}",
}
SWEPT = "--out out.nc --check"
CASES = {
    "measure": {
        "": "lone --duration 0.4",
        "--impedance": "lone --impedance --duration 3",
        IN_ADMITTANCE: "simulated --duration 0.4",
        IN_PLANE: "ring --duration 1",
        "--hands": "linked --hands --duration 1",
        "--mass": "lone --mass --duration 0.4",
        "--record": "lone --record out.trace --duration 0.4",
        SEVERAL: "several --duration 1",
    },
    "check": {
        "": "lone",
        IN_PLANE: "ring",
        "--along": "ring --along 0,0:5mm,1mm",
        SEVERAL: "several",
    },
    "sweep": {
        "": "contact device.delay=0.5,1 --out out.nc --duration 0.4",
        "--points": f"contact --points points.csv {SWEPT}",
        "--samples": f"contact device.delay=lin:0:2 --samples 2 {SWEPT}",
        "--check": f"contact device.delay=0.5,1 {SWEPT}",
        "--measure": "contact device.delay=0.5 --out out.nc --measure --duration 0.4",
        "--impedance": "lone device.delay=0.5 --out out.nc --impedance --duration 3",
        "--scheduler": f"contact device.delay=0.5,1 {SWEPT} --scheduler tcp://127.0.0.1:9",
        "--picture": f"contact device.delay=0.5,1 rate=900,1000 {SWEPT} --picture out.svg",
        "--data": f"contact device.delay=0.5,1 rate=900,1000 {SWEPT} --data out.csv",
    },
    "plane": {
        "": "--rate 1000 --mass 0.2 --data out.csv",
        "SCENE": "lone --data out.csv",
        IN_ADMITTANCE: "simulated --data out.csv",
    },
    "felt": {
        "": "--rate 1000 --mass 0.2 --data out.csv",
        "SCENE": "lone --data out.csv",
        "--over": "lone --over device.mass --data out.csv",
    },
    "force": {"": "lone --json", IN_PLANE: "ring --json"},
    "transparency": {
        "": "--rate 1000 --mass 0.2 --simulated-stiffness 1000 --json",
        "SCENE": "lone --json",
        COUPLED: "masses --json",
    },
}
"""The words of each command in each of its modes. The first word that names a scene above is its file."""
VALUES = {
    "SCENE": "lone", "PARAMETERS": "device.delay=0.5,1", "--at": "2mm", "--along": "0,0:1mm,0", "--channel": "7",
    "--duration": "0.5", "--port": "/dev/null", "--transport": "terminal", "--push": "0.2", "--hand-stiffness": "500",
    "--travel": "2mm", "--picture": "out.svg", "--data": "out.csv", "--record": "out.trace", "--hand-mass": "1",
    "--out": "other.nc", "--samples": "3", "--method": "random", "--seed": "1", "--points": "points.csv", "--jobs": "2",
    "--scheduler": "tcp://127.0.0.1:9", "--draw": "predicted_b", "--over": "rate,device.delay", "--mass": "0.3",
    "--to-stiffness": "500", "--to-damping": "5", "--rate": "900", "--friction": "2", "--stiffness": "100",
    "--delay": "2", "--hold": "impulse", "--sampling": "average", "--damper": "centred", "--cutoff": "100",
    "--simulated-stiffness": "1200", "--simulated-damping": "3", "--area": "0,0:1mm,1mm", "--speed": "0.1",
    "--device": "right",
}  # fmt: skip
UNSEEN = {
    ("sweep", "--jobs"): "only how fast it is",
    ("sweep", "--scheduler"): "so few points are computed here",
    ("felt", "--normalised"): "the title of the picture",
    ("check", "--require-stable"): "the status of unstable scenes alone",
    ("measure", SEVERAL, "--transport"): "in virtual time, where the mocks are",
}
"""Effects that this test does not see, by command, mode if not all, and option."""


EVERY = [(command, mode) for command, modes in CASES.items() for mode in modes]


def parameters_of(command: str) -> dict[str, bool]:
    """The table's words for the parameters of a command, and whether each is a flag."""
    group: Any = ChartCommands(name="chart") if command in ChartCommands.table else Commands(name="hapsim")
    every = group._loaded(command).params
    return {word_of(one): getattr(one, "is_flag", False) for one in every if one.name != "help"}


def tried(command: str, mode: str) -> Iterator[tuple[str, list[str], str]]:
    """Each option that the words of a mode do not have; these words with it; and why the table refuses it, or ""."""
    words = CASES[command][mode].split()
    facts = [mode] if mode in (IN_PLANE, IN_ADMITTANCE, COUPLED, SEVERAL) else [IN_PLANE] if "ring" in words else []
    parameters = parameters_of(command)
    for option, is_flag in parameters.items():
        given = {"SCENE": words[0] in SCENES, "PARAMETERS": "=" in "".join(words)} | dict.fromkeys(words, True)
        if given.get(option) and (option in (mode, "--data") or is_flag or not option.startswith("-")):
            continue
        value = "2mm,0" if (option, words[0]) == ("--at", "ring") else VALUES.get(option, "")
        value = "device.friction" if (command, option) == ("felt", "--over") else value
        more = [*words, option][: len(words) + option.startswith("-")] + [value][: not is_flag]
        why = refusal(command, [one for one in parameters if given.get(one) or one == option], facts)
        yield option, more, why


@pytest.fixture
def result(hapsim: Callable[..., Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[..., Any]:
    """Calls a command in a directory of its own, and returns what came of it: status, output, errors and files. A
    picture is the text of its numbers."""
    monkeypatch.chdir(tmp_path)
    few = {"_POINTS": (12, 6), "_POINTS_OF_A_SHARE": (2, 2), "_MASSES": np.array([0.7, 1.0]), "_TRUE_VALUES": 5}
    monkeypatch.setattr("hapsim.chart.felt_chart.SHARES", felt_chart.SHARES[:1])
    for name, value in (few | {"_DELAYS": np.array([0.0, 1.0])}).items():
        monkeypatch.setattr(f"hapsim.chart.felt_chart.{name}", value)

    def write(options: PictureOptions, columns: Callable[[], Any], _: object) -> None:
        for path in filter(None, (options.picture, options.data)):
            path.write_text(str({name: list(values) for name, values in columns().items()}))

    monkeypatch.setattr(PictureOptions, "write", write)

    def call(command: str, words: list[str], option: str = "") -> tuple[int, str, str, dict[str, str]]:
        for path in tmp_path.iterdir():
            shutil.rmtree(path) if path.is_dir() else path.unlink()
        for name, text in SCENES.items():
            stiffness, port = (
                ("900000" if option == "--unstable" else "1000"),
                ", port: /dev/null" * (option == "--mock"),
            )
            Path(name).write_text(text.replace("PORT", port).replace("STIFF", stiffness))
        Path("points.csv").write_text("device.delay\n0.5\n")
        if option == "--overwrite":
            Path("out.trace").touch()
        answer = hapsim(*["chart"][: command in ChartCommands.table], command, *words)
        out = re.sub(r"(running|swept) .*|[-\d.]+ [mµn]?s\b.*", "", answer.out)  # times
        files = {path.name: path.read_text() for path in tmp_path.glob("out.[cs]*")}
        return (
            answer.status,
            out,
            answer.err if answer.status else "",
            files | dict.fromkeys(map(str, tmp_path.iterdir()), ""),
        )

    return call


@pytest.mark.parametrize("command", MODES)
def test_the_table_has_every_option_of_its_command_and_every_mode_is_tried(command: str) -> None:
    modes = {mode for group in MODES[command] for mode in group}
    listed = {option for group in MODES[command] for options in group.values() for option in options.split()}
    assert listed | modes - {"", IN_PLANE, IN_ADMITTANCE, COUPLED, SEVERAL} == {*parameters_of(command)}
    assert modes | {""} == {*CASES[command]}


@pytest.mark.thorough(keep=len(MODES))
@pytest.mark.parametrize(("command", "mode"), EVERY)
def test_an_option_that_does_not_go_with_the_mode_is_refused(
    result: Callable[..., Any], command: str, mode: str
) -> None:
    for option, words, why in tried(command, mode):
        if why:
            status, _, err, _ = result(command, words)
            assert (option, status, " ".join(err.split())) == (option, 2, why)


@pytest.mark.parametrize(
    ("command", "mode"),
    [one if one == ("measure", "--hands") else pytest.param(*one, marks=pytest.mark.thorough) for one in EVERY],
)
def test_an_option_that_is_not_refused_changes_what_comes_of_the_command(
    result: Callable[..., Any], command: str, mode: str
) -> None:
    plain, again = (result(command, CASES[command][mode].split()) for _ in range(2))
    assert plain == again
    assert plain[0] == 0, plain
    for option, words, why in tried(command, mode):
        if not why and not {(command, option), (command, mode, option)} & UNSEEN.keys():
            without = plain
            if option in ("--mock", "--unstable", "--overwrite"):
                without = result(command, CASES[command][mode].split(), option)
            assert (option, *result(command, words, option)) != (option, *without)


def test_the_sentence_names_option_mode_and_remedy() -> None:
    assert refusal("measure", ["SCENE", "--hands", "--z-width", "--hand-stiffness"]) == (
        "--z-width does not go with --hands; leave it out"
    )
    assert refusal("sweep", ["SCENE", "--draw"]) == "--draw needs --picture or --data; otherwise leave it out"
    assert refusal("force", ["SCENE", "--speed"], [IN_PLANE]) == (
        "--speed does not go with a scene with space: 2; leave it out"
    )
    assert refusal("measure", ["SCENE", "--mass", "--hand-stiffness"]) == ""
