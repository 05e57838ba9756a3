"""The options that go with each mode of a command, in one table, which refuses all others.

A mode is what a command does because of an option (`measure --impedance`) or of the scene (a hand in the plane).
"""

from __future__ import annotations

from collections.abc import Collection
from typing import Any

from typer import Context

from hapsim.errors import UsageError

IN_PLANE = "a scene with space: 2"
IN_ADMITTANCE = "a scene in admittance"
SEVERAL = "a scene with several devices"
COUPLED = "a hand that moves masses or another hand, or has a predictor"

_HAND = "--rate --friction --stiffness --delay --hold --sampling --damper --cutoff"
_SIMULATED = "--simulated-stiffness --simulated-damping"
_OUTPUT = "--picture --data --json"

Modes = dict[str, str]
"""The options that each mode takes. The first mode that is given or true is the command's, else that of the name ""."""

MODES: dict[str, tuple[Modes, ...]] = {
    "measure": (
        {SEVERAL: "", "": "--channel --record"},
        {"": "SCENE --device --port --mock --transport --duration --push --unstable --json"},
        {
            SEVERAL: "",
            IN_ADMITTANCE: "--explain",
            "--impedance": "--travel --z-width --picture --data",
            IN_PLANE: "--at",
            "--hands": "",
            "": "--at --branch --mass --picture --data --explain --methods",
        },
        {"--mass": "--hand-stiffness"},
        {"--record": "--overwrite"},
    ),
    "check": (
        {"": "SCENE --device --json --require-stable"},
        {IN_PLANE: "--along"},
        {"--along": "", SEVERAL: "--explain", "": "--at --explain --hand-mass --hand-stiffness"},
    ),
    "sweep": (
        {"": "SCENE --device --out --channel --json"},
        {"--points": "", "": "PARAMETERS --samples"},
        {"--samples": "--method --seed"},
        {"--check": "--at", "--measure": "--at --duration", "--impedance": "--duration", "": "--at --duration"},
        {"--scheduler": "", "": "--jobs"},
        {"--picture": "--data --draw --over", "--data": "--draw --over"},
    ),
    "plane": (
        {"": f"SCENE --to-damping {_OUTPUT}"},
        {IN_ADMITTANCE: "", "": f"--mass --normalised --total-damping --to-stiffness {_HAND} {_SIMULATED}"},
        {"SCENE": "--channel --device"},
    ),
    "felt": (
        {"": f"SCENE {_OUTPUT}"},
        {"SCENE": "--channel --over --device"},
        {"--over": "", "": f"--mass --normalised {_HAND}"},
    ),
    "force": (
        {"": f"SCENE --device --channel {_OUTPUT}"},
        {IN_PLANE: "--area", "": "--speed"},
    ),
    "transparency": (
        {"": f"SCENE {_OUTPUT}"},
        {"SCENE": "--channel --device"},
        {COUPLED: "", "": f"--mass {_HAND} {_SIMULATED}"},
    ),
}
"""For each command the questions that its options and the scene answer, each with its modes. An option may stand in
several: it has to go with the mode of each."""


def refusal(command: str, given: Collection[str], facts: Collection[str] = ()) -> str:
    """Returns why one of the given options does not go with the command's mode; "" if all do. `facts`: what is true of
    the scene."""
    for modes in MODES[command]:
        mode = next((one for one in modes if one in given or one in facts), "")
        taken = {mode, *modes.get(mode, "").split()}
        for option in given:
            takers = [one for one, options in modes.items() if option in options.split()]
            if option in taken or not (takers or option in modes):
                continue
            if mode:
                instead = ", or add --device NAME" if mode == SEVERAL else ""
                return f"{option} does not go with {mode}; leave it out{instead}"
            return f"{option} needs {' or '.join(takers)}; otherwise leave it out"
    return ""


def word_of(parameter: Any) -> str:
    """Returns the table's word for a parameter of a command: --push, or SCENE for an argument."""
    name: str = parameter.opts[0]
    return name if name.startswith("-") else name.upper()


def require_mode(context: Context, scene: Any = None, *facts: str) -> None:
    """Raises UsageError for an option of the command line that does not go with the command's mode. `scene`: the Scene
    that it depends on, if any. `facts`: what else is true of it."""
    facts += (IN_PLANE,) if scene is not None and scene.space > 1 else ()
    facts += (IN_ADMITTANCE,) if scene is not None and not scene.ports and scene.device.is_admittance else ()
    facts += (SEVERAL,) if scene is not None and scene.ports else ()
    command: Any = context.command
    sources = {word_of(one): context.get_parameter_source(one.name) for one in command.params}
    given = [word for word, source in sources.items() if source is not None and source.name == "COMMANDLINE"]
    if why := refusal(command.name, given, facts):
        raise UsageError(why)
