"""Faulty devices at a pseudo-terminal, in plain Python (tests/probe/device.py): what the guards make of them.

    tools/bench/on_port [--only WORDS ...]

Each case runs with the guard that it is about, and without: then the motor counts as known, or what a hand that is
armed inside a wall may get is not limited. A run is repeated where this machine held the device up.
"""

from __future__ import annotations

import argparse
import os
import tempfile
from collections.abc import Iterator
from typing import Any
from unittest import mock

import hapsim
from hapsim.device.known_motors import note_motors
from hapsim.errors import DeviceError, HapsimError
from tests.probe.on_port import device_on_port

SPRING = {"type": "viscoelastic", "stiffness": 2000, "damping": 5}
WALL = {"type": "buffer", "stiffness": 2000, "damping": 5}
DISC = {"type": "shape", "form": {"disc": 0.02}, "stiffness": 2000, "damping": 5}
PULLED = [{"hand": 0.5}]  # N, from rest
ATTEMPTS = 5

CASES: dict[str, tuple[dict[str, Any], dict[str, Any], dict[str, Any]]] = {
    "inverted, counts of 0.4 mm": ({"faults": ["inverted_sign"], "scale": 4e-4, "bodies": PULLED}, SPRING, {}),
    "inverted, counts of 0.4 mm, travel of 5 cm": (
        {"faults": ["inverted_sign"], "scale": 4e-4, "bodies": PULLED},
        SPRING,
        {"travel": [-0.05, 0.05]},
    ),
    "inverted, 250 Hz, 500 N/m": (
        {"faults": ["inverted_sign"], "rate": 250.0, "bodies": PULLED},
        SPRING | {"stiffness": 500},
        {},
    ),
    "plane, turned by 40 degrees": ({"turned": 40.0, "channels": 2, "bodies": [{"hand": 0.5}, {}]}, SPRING, {}),
    "armed 20 mm inside a wall": ({"bodies": [{"x": -0.02}]}, WALL, {"origin": 0.0}),
    "armed in the middle of a disc": ({"channels": 2, "bodies": [{"x": 1e-5}, {}]}, DISC, {"origin": 0.0}),
    "sensor dies after 0.3 s under a hand": ({"dies_at": 300, "bodies": [{"hand": 2.0}]}, SPRING, {}),
    "host paces, answers take 40 ms": ({"answers_after": 0.04, "bodies": PULLED}, SPRING, {"clock": "host"}),
    "acceleration stuck, slew limit of 300 N/s": (
        {"accelerates": True, "stuck_at": 60, "bodies": [{"v": 0.1}]},
        SPRING | {"stiffness": 8000, "damping": 10},
        {"sensors": ["velocity", "acceleration"], "correction": "sensed", "slew_limit": 300.0},
    ),
}

TURNS = {
    "x inverted": [[-1, 0], [0, 1]],
    "both inverted": [[-1, 0], [0, -1]],
    "exchanged": [[0, 1], [1, 0]],
    "turned by 90 degrees": [[0, -1], [1, 0]],
    "turned by -90 degrees": [[0, 1], [-1, 0]],
    "right": [[1, 0], [0, 1]],
}
"""The forces that the motors of x and y make of one."""
SOFT = {"type": "shape", "form": {"disc": 0.001}, "side": "inside", "stiffness": 1000, "damping": 3}
for um in (1, 20, 100):
    coarse = {"scale": 1e-6 * um}
    CASES[f"counts of {um} µm, inverted"] = ({"faults": ["inverted_sign"], "bodies": PULLED, **coarse}, SPRING, {})
    for name, motors in TURNS.items():
        bodies = [{"hand": 0.5}, {"hand": 0.2}]
        CASES[f"counts of {um} µm, plane, {name}"] = (
            {"channels": 2, "motors": motors, "bodies": bodies, **coarse},
            SOFT,
            {},
        )


def scene_of(port: str, options: dict[str, Any], link: dict[str, Any], device: dict[str, Any]) -> hapsim.Scene:
    """Returns a scene of one hand on one link to a ground at 0, at the force limit of 10 N."""
    plane = options.get("channels", 1) == 2
    hand = {"type": "device", "channels": [0, 1]} if plane else {"type": "device", "channel": 0}
    modules = {"hand": hand, "post": {"type": "ground", "position": [0, 0] if plane else 0.0}}
    modules["link"] = link | {"between": ["hand", "post"]}
    declared = {"port": port, "mass": 0.2, "friction": 1.0, "force_limit": 10.0, "origin": "here"} | device
    rate = options.get("rate", 1000.0)
    whole = {"version": 1, "rate": rate, "space": 1 + plane, "device": declared, "modules": modules}
    return hapsim.Scene.model_validate(whole)


def outcome(case: str, guarded: bool) -> tuple[str, dict[str, float]]:
    """Returns how a run of 1.5 s ended, and what happened to the device."""
    options, link, declared = CASES[case]
    for _ in range(ATTEMPTS):
        with device_on_port(**{"rate": 1000.0} | options) as device:
            note_motors(device.port, range(2), are_right=not guarded or case.startswith("armed"))
            try:
                report = hapsim.run(scene_of(device.port, options, link, declared), duration=1.5).report
                ended = f"status 0, {report.ending}"
            except DeviceError:
                continue
            except HapsimError as error:
                ended = f"status {error.exit_status}, {str(error).removeprefix(f'{device.port}: ').partition('. ')[0]}"
        return ended, device.end()
    return "the device was held up in every run", {}


def rows(only: list[str]) -> Iterator[str]:
    for case in CASES:
        if not all(word in case for word in only):
            continue
        for guarded in (True, False):
            with mock.patch("hapsim.loop.guards.armed_inside.ARMED_INSIDE", 0.1 if guarded else 1e9):
                ended, seen = outcome(case, guarded)
            figures = ", ".join(
                f"{seen[name]:.3g} {unit}"
                for name, unit in (("farthest", "m"), ("fastest", "m/s"), ("largest", "N"))
                if seen
            )
            yield f"{case}; {'with' if guarded else 'without'}: {figures}; {ended}"


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", nargs="*", default=[])
    os.environ["XDG_STATE_HOME"] = tempfile.mkdtemp()
    for row in rows(parser.parse_args().only):
        print(row, flush=True)
