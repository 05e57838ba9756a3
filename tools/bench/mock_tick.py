"""Cost of a sample of the mock in virtual time, without and with a transmission.

    tools/bench/mock_tick [--rounds 15] [--samples 20000]

Every kind gets the same random forces, one a sample. The kinds take turns within a
round; processor time is measured.
"""

from __future__ import annotations

import argparse
import statistics
import time
from typing import Any

import numpy as np

from hapsim.compiling import entry
from hapsim.device.mock.assemble_mock import assemble_mock
from hapsim.device.mock.firmware import call_advance, prepare
from hapsim.scene import parse_scene

BELT = "stiffness: 20 N/mm, damping: 3, motor_mass: 50 g"
KINDS = {
    "one mass": ("", ""),
    "dry friction": ("", "coulomb: 0.1"),
    "motor lag 0.3 ms": ("motor_lag: 0.3 ms", ""),
    "cogging": ("", "cogging: {force: 0.1, pitch: 1 mm}"),
    "belt": (f"transmission: {{{BELT}}}", ""),
    "belt of 1 MN/m": (f"transmission: {{{BELT.replace('20 N', '1000 N')}}}", ""),
    "belt, backlash 0.1 mm, dry friction": (f"transmission: {{{BELT}, backlash: 0.1 mm}}", "coulomb: 0.1"),
}


@entry
def advance_often(mock: Any, forces: Any) -> None:
    """Moves the bodies through a sample of 1 ms after each command."""
    for n in range(forces.size):
        mock.board.n = mock.board.accepted = n
        mock.commands[n % mock.depth, 0] = forces[n]
        call_advance(mock.called.advance, (mock.address, 1e-3, 1e-3))


def mock_of(device: str, mock: str) -> Any:
    """Returns a mock of 200 g, prepared, with these keys."""
    text = f"""
version: 1
rate: 1000
device: {{clock: lockstep, mass: 0.2, friction: 1{", " * bool(device)}{device}}}
mock: {{hand: {{stiffness: 300}}{", " * bool(mock)}{mock}}}
modules: {{hand: {{type: device, channel: 0}}}}
"""
    made = assemble_mock(parse_scene(text))
    prepare(made)
    made.bodies[:1] = made.initial[:1]
    return made


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rounds", type=int, default=15)
    parser.add_argument("--samples", type=int, default=20_000)
    options = parser.parse_args()
    forces = np.random.default_rng(1).normal(0.0, 1.0, options.samples)
    mocks = {name: mock_of(*keys) for name, keys in KINDS.items()}
    costs: dict[str, list[float]] = {name: [] for name in KINDS}
    for number in range(options.rounds + 1):
        for name, mock in mocks.items():
            begin = time.process_time()
            advance_often(mock, forces)
            if number:  # the first one compiles
                costs[name].append(1e6 * (time.process_time() - begin) / options.samples)
    for name, each in costs.items():
        print(f"{name:36s} {statistics.median(each):7.3f} [{min(each):.3f}, {max(each):.3f}] µs a sample")


if __name__ == "__main__":
    main()
