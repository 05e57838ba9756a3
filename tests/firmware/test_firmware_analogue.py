"""The analogue boards on their emulated chip, whose pins are joined to motor, friction and sensor, over a port.

In virtual time: the chip's clock stands still while the host thinks, and what this machine has else to do is not felt.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import firmware_protocol
import hapsim
from hapsim.bringup.probe import STEPS
from hapsim.device.connection import describe
from hapsim.device.ports import open_serial_port
from hapsim.errors import DeviceError
from hapsim.loop.ring import LATE_FORCE
from hapsim.running import Excitation
from hapsim.scene import Scene
from hapsim.scene.words import Input

FIRMWARE = Path(firmware_protocol.__file__).parent / "firmware"
BOARDS = Path(__file__).parents[2] / "configs" / "boards"
QUIET = ("coulomb=0", "noise=0")
Start = Callable[..., Any]

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="boards stand on pseudo-terminals of Linux")


@pytest.fixture
def on_board(start_board: Start, built: Path) -> Callable[..., tuple[Scene, Any]]:
    """The first scene of a board, on that board with these properties, and the board."""

    def start(name: str, *properties: str) -> tuple[Scene, Any]:
        board = start_board(name, built, "lockstep=1", *properties)
        scene = hapsim.load_scene(BOARDS / f"{name.rstrip('4')}.yaml")
        changes = {"port": board.port, "clock": "lockstep"}
        return scene.model_copy(update={"device": scene.device.model_copy(update=changes), "mock": None}), board

    return start


@pytest.mark.thorough
@pytest.mark.parametrize("name", ["hapkit", "firefader"])
def test_a_first_scene_feels_as_predicted(name: str, on_board: Start) -> None:
    """The real delay is a little more than the one sample declared: the tick takes time until the force acts."""
    scene, _ = on_board(name, *QUIET)
    predicted, measured = hapsim.predict(scene), hapsim.measure(scene)
    assert measured.k == pytest.approx(predicted.k, rel=0.03)
    assert measured.b == pytest.approx(predicted.b, rel=0.06)


@pytest.mark.thorough
def test_four_faders_are_answered_in_time(on_board: Start) -> None:
    scene, board = on_board("faders4")
    assert not any(duty for _, duty in board.forces())
    pushed = Excitation(0, 0.5, 20, 40, start=0, first=True)
    trace = hapsim.run(scene, duration=0.4, excitation=pushed)
    in_step = trace.flags[5:]  # before that, on a busy machine, what is left of arming ends the chip's wait too early
    assert not (in_step & LATE_FORCE).any()
    assert max(duty for _, duty in board.forces()) > 100
    assert abs(trace.position[:, 0]).max() > 1e-3 > abs(trace.position[:, 1:]).max()


def test_a_finger_on_a_firefader_is_seen_at_the_first_sample_after_it_comes_and_for_a_mains_period_when_it_goes(
    on_board: Start,
) -> None:
    """Each sample charges the pads. The last one that sees the finger begins the 20 for which a touch stays."""
    scene, _ = on_board("firefader", "touch=0.0503", "lift=0.0803", "noise=0")
    scene = scene.model_copy(update={"inputs": {"left": Input(bit=0), "right": Input(bit=1)}})
    trace = hapsim.run(scene, duration=0.15, excitation=Excitation(0, 0.5, 20, 40, start=20, first=False))
    first = int(np.flatnonzero(trace.force[:, 0])[0])
    # The sample from which it acts. At 1 kHz and 1 Mbaud the chip hardly has time for a word, and forces may be late.
    driven = trace.sample[first] + 1 + bool(trace.flags[first + 1] & LATE_FORCE)
    touched = trace.sample[(trace.inputs & 1) == 1] - driven
    assert touched.tolist() == [*range(51, 80 + 20)]
    assert not (trace.inputs & ~np.uint32(1)).any()


@pytest.mark.thorough
def test_mass_is_found_and_the_back_emf_as_friction(on_board: Start) -> None:
    scene, _ = on_board("hapkit", "coulomb=0.05", "friction=0.1", "emf=0.6", "mass=0.12")
    found = hapsim.identify_device(scene, force=1.0, travel=0.02)
    assert found.mass.value == pytest.approx(0.12, rel=0.02)
    assert found.friction.value == pytest.approx(0.7, rel=0.1)
    assert found.coulomb.value == pytest.approx(0.05, rel=0.1)
    assert found.delay.value == pytest.approx(1.04, abs=0.15)


@pytest.mark.parametrize(("name", "fault"), [("hapkit", "leap"), ("firefader", "wire_off"), ("hapkit", "wire_off")])
def test_a_sensor_that_cannot_be_releases_the_force_at_once(name: str, fault: str, on_board: Start) -> None:
    scene, board = on_board(name, f"{fault}=0.2", "coulomb=0")
    with pytest.raises(DeviceError, match="a fault in its own hardware"):
        hapsim.run(scene, duration=2.0, excitation=Excitation(0, 0.5, 20, 40, start=0, first=True))
    driven = [at for at, duty in board.forces() if duty]
    assert board.forces()[-1][1] == 0
    assert driven[-1] - driven[0] < 200_000 + 4000  # two readings in a row, and the tick that follows


@pytest.mark.thorough
def test_the_hapkit_passes_every_check_that_can_be_seen_of_it(start_board: Start, built: Path, hapsim: Start) -> None:
    board = start_board("hapkit", built, "coulomb=0")
    steps = [word for step in STEPS if step != "blocked" for word in ("--only", step)]
    answer = hapsim("probe", board.port, "--push", 4, "--travel", 0.04, *steps, "--json")
    checks = {check["name"]: check["result"] for check in answer.document["checks"]}
    assert "fail" not in checks.values(), answer.document
    assert sum(result == "pass" for result in checks.values()) > 45


@pytest.mark.thorough
def test_the_wire_takes_the_time_of_the_baud_that_is_built(once: Any, start_board: Start) -> None:
    """The emulated clock is never ahead of this machine's: at least that long."""
    build = ["bash", "-c", f'"{FIRMWARE}/build" "$0" avr hapkit']
    slow = once("slow", build, {"DEFINES": "-DHAPSIM_BAUD=115200ul"})
    with closing(open_serial_port(start_board("hapkit", slow).port, 115200)) as connection:
        begun = time.monotonic()
        description = describe(connection)
        lasted = time.monotonic() - begun
    assert description.rate_hz == 400.0
    assert lasted > 20 * 23 * 10 / 117647  # 20 registers, 23 bytes each; 16 MHz / 8 / 17
