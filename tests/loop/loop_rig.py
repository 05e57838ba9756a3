"""Scenes to loop over, and a device that follows a script."""

from __future__ import annotations

import contextlib
import os
import select
import threading
import tty
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any
from unittest import mock

import numpy as np

from firmware_protocol import schema
from firmware_protocol.decoder import Frame, frames_in, new_decoder, use_format
from firmware_protocol.description import Description, to_registers
from firmware_protocol.frames import SETUP, armed_format, frame_to_host
from hapsim.device.connection import Connection
from hapsim.device.known_motors import note_motors
from hapsim.device.mock.assemble_mock import assemble_mock
from hapsim.device.mock.terminal import serving
from hapsim.loop.portable import _take_and_compose
from hapsim.loop.transport import descriptor_transport
from hapsim.recording.trace import Trace
from hapsim.running import run
from hapsim.running.assemble_loop import LoopMemory, assemble_loop
from hapsim.running.session_options import RunOptions
from hapsim.scene import Scene

CLOCKS = ["lockstep", "device", "host"]
POSITION_SCALE, FORCE_SCALE = 1e-6, 1e-3
HANG_UP = None  # in a script: the device closes its port


def scene_of(
    channels: int = 1,
    *,
    stiffness: float = 1000.0,
    damping: float = 2.0,
    damper: str = "backward",
    rate: float = 1000.0,
    **parts: Any,
) -> Scene:
    """Every channel's hand on a spring of its own, each a tenth stiffer than the one before."""
    modules: dict[str, Any] = {"wall": {"type": "ground"}}
    for c in range(channels):
        modules[f"hand{c}"] = {"type": "device", "channel": c}
        modules[f"touch{c}"] = {
            "type": "viscoelastic",
            "between": [f"hand{c}", "wall"],
            "stiffness": stiffness * (1 + c / 10),
            "damping": damping,
            "damper": damper,
        }
    device = {"mass": 0.2, "friction": 1.0, "clock": "lockstep"} | parts.get("device", {})
    mock = {"initial": {"velocity": 0.1}} | parts.get("mock", {})
    document = {"version": 1, "rate": rate, "device": device, "mock": mock, "modules": modules}
    return Scene.model_validate(document)


def on_port(scene: Scene, path: str) -> Scene:
    """The same scene, its device behind this port."""
    return scene.model_copy(update={"device": scene.device.model_copy(update={"port": path})})


@contextlib.contextmanager
def served(scene: Scene) -> Iterator[tuple[Scene, Any]]:
    """The scene's mock on a pseudo-terminal, open to look at; and the scene with its port."""
    made = assemble_mock(scene)
    with serving(made) as path:
        yield on_port(scene, path), made


def frame(
    number: int,
    *counts: int,
    kind: int = schema.POSITION,
    velocity: Sequence[int] = (),
    acceleration: Sequence[int] = (),
    hand_force: Sequence[int] = (),
) -> bytes:
    """A position frame of an armed device, with velocities where given, sample numbers as on the wire. Sensed forces
    go with commands."""
    parts = (schema.WITH_VELOCITY if velocity else 0) | (schema.WITH_ACCELERATION if acceleration else 0)
    parts |= schema.ADMITTANCE if hand_force else 0
    wire = armed_format(len(counts), parts)
    sent = [*counts, *velocity, *acceleration, *hand_force]
    return frame_to_host(wire, kind, number % schema.SAMPLE_MODULUS, sent)


def alike(channels: int, **each: float) -> dict[str, tuple[float, ...]]:
    """The description of a scripted device whose channels are all alike: what differs from its own of one channel."""
    own = {"position_scale": POSITION_SCALE, "force_scale": FORCE_SCALE, "force_limit": 10.0}
    return {name: (value,) * channels for name, value in (own | each).items()}


def run_with_loop(scene: Scene, **options: Any) -> tuple[Trace, LoopMemory]:
    """Returns the trace of a run, and its loop as that stands at the end."""
    sessions: list[Any] = []
    trace = run(scene, on_start=sessions.append, **options)
    return trace, sessions[0]._loop


def require_same(one: Trace, other: Trace, ticks: int | None = None, *more: str) -> None:
    """Asserts that two traces have the same samples, flags, positions and forces, and `more`, to the bit. `ticks`: of
    the other, its first rows."""
    for name in ("sample", "flags", "position_counts", "force_counts", "asked_force", *more):
        found, expected = getattr(one, name), getattr(other, name)[:ticks]
        assert found.dtype == expected.dtype
        np.testing.assert_array_equal(found, expected, err_msg=name)
    for name in ("position_scale", "force_scale", "rate"):
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name))


def as_it_is(scene: Scene) -> Scene:
    """The scene whose force is neither slewed nor judged by its energy, where it names no bounds: a script's positions
    are no hand's, and a force of half a newton in the first sample is what is asked for."""
    off = {"slew_limit": 1e12, "soft_start": 0.0, "energy_limit": 1e12}
    changes = {key: value for key, value in off.items() if getattr(scene.device, key) is None}
    return scene.model_copy(update={"device": scene.device.model_copy(update=changes)})


class ScriptedDevice:
    """Speaks the protocol up to arming; then each item of `script` (bytes, or HANG_UP) answers one event: the arming
    first, then force after force. When the script is over it stays silent."""

    def __init__(self, near: int, script: Sequence[bytes | None], **differences: Any) -> None:
        refuses = differences.pop("refuses", schema.NO_FAULT)
        self.answers_arm_with: int | None = differences.pop("answers_arm_with", None)  # a status, and stays unarmed
        self.ignores_arm: bool = differences.pop("ignores_arm", False)
        self.says_on_disarm: int = differences.pop("says_on_disarm", schema.IDLE)
        self.hangs: bool = differences.pop("hangs", False)  # once armed it hears nothing but forces
        self.before: bytes = differences.pop("before", b"")
        self.registers_set: dict[int, int] = differences.pop("registers", {})
        self.description = replace(
            Description(
                name="script",
                rate_hz=1000.0,
                pacings=0b111,
                max_watchdog_samples=200,
                **alike(1),
            ),
            **differences,
        )
        self.armed = False
        self.deaf = False
        self.before_each = self.after_each = b""  # around everything that is heard before arming
        self.disarmed = 0
        self.arms: list[Frame] = []
        self.forces: list[Frame] = []
        self.farewells: list[Frame] = []  # by which it was disarmed while it was armed
        self.stop = threading.Event()
        self._near, self._script, self._refuses = near, list(script), refuses
        self._decoder = new_decoder(SETUP, to_device=True)
        self._registers = to_registers(self.description)
        for number, value in self.registers_set.items():
            self._registers[number] = value

    def write(self, data: bytes) -> None:
        os.write(self._near, data)

    def serve(self) -> None:
        self.write(self.before)
        while not self.stop.is_set():
            if not select.select([self._near], [], [], 0.01)[0]:
                continue
            try:
                data = os.read(self._near, 4096)
            except OSError:
                return
            if not self.armed:
                self.write(self.before_each)
            # The format changes with a frame: byte by byte, none is read in the wrong one.
            for byte in data:
                for frame in frames_in(self._decoder, bytes([byte])):
                    if not self.deaf and not self._take(frame):
                        return
            if not self.armed:
                self.write(self.after_each)

    def _take(self, frame: Frame) -> bool:
        if frame.type == schema.DESCRIBE and not self.armed:
            value = int(np.array(self._registers[frame.number]).astype(np.uint32).astype(np.int32))
            os.write(self._near, frame_to_host(SETUP, schema.DESCRIPTION, frame.number, [value]))
        elif frame.type == schema.ARM and not self.armed:
            return self._arm(frame)
        elif frame.type == schema.FORCE and self.armed:
            self.forces.append(frame)
            return self._next()
        elif frame.type == schema.DISARM and not (self.hangs and self.armed):
            self.farewells += [frame] if self.armed else []
            self.armed, self.disarmed = False, self.disarmed + 1
            use_format(self._decoder, SETUP)
            self._status(self.says_on_disarm, schema.NO_FAULT)
        return True

    def _arm(self, frame: Frame) -> bool:
        self.arms.append(frame)
        if self.ignores_arm:
            return True
        if self.answers_arm_with is not None:
            self._status(self.answers_arm_with & 0xFF, self.answers_arm_with >> 8)
            return True
        if self._refuses != schema.NO_FAULT:
            self._status(schema.IDLE, self._refuses)
            return True
        self._status(schema.ARMED, schema.NO_FAULT)
        self.armed = True
        use_format(self._decoder, armed_format(self.description.channels, frame.argument & schema.PART_BITS))
        return self._next()

    def _status(self, state: int, fault: int) -> None:
        os.write(self._near, frame_to_host(SETUP, schema.STATUS, 0, [state | fault << 8]))

    def _next(self) -> bool:
        item = self._script.pop(0) if self._script else b""
        if item is HANG_UP:
            os.close(self._near)
            return False
        os.write(self._near, item)
        return True


@contextlib.contextmanager
def scripted(
    script: Sequence[bytes | None] = (), scene: Scene | None = None, **differences: Any
) -> Iterator[tuple[Scene, ScriptedDevice]]:
    """A scripted device on a pseudo-terminal, and a scene of one spring (1000 N/m, 2 N·s/m) with its port. A script
    keeps no time: how old its positions are says only how busy this machine is."""
    near, far = os.openpty()
    path = os.ttyname(far)
    for end in (near, far):
        tty.setraw(end)
    note_motors(path, range(schema.MAX_CHANNELS), are_right=True)
    device = ScriptedDevice(near, script, **differences)
    thread = threading.Thread(target=device.serve)
    thread.start()
    try:
        with mock.patch("hapsim.running.assemble_loop._stale_ns", return_value=1 << 62):
            yield on_port(as_it_is(scene or scene_of()), path), device
    finally:
        device.stop.set()
        thread.join()
        for end in (near, far):
            with contextlib.suppress(OSError):
                os.close(end)


def assembled(
    scene: Scene, descriptor: int = 0, options: RunOptions | None = None, is_port: bool = False, **differences: Any
) -> LoopMemory:
    """A loop over a port's descriptor, armed; a loop without a listener takes any descriptor."""
    c = scene.channels
    description = Description("test", 1000.0, 0b111, 200, (1e-6,) * c, (1e-3,) * c, (10.0,) * c)
    transport = descriptor_transport(descriptor)
    connection = Connection(transport=transport, name="test", close=lambda: None, behind_port=is_port)
    loop = assemble_loop(scene, connection, replace(description, **differences), options)
    loop.connection = connection  # type: ignore[attr-defined]  # it has but the address of what it receives from
    use_format(loop.inbox.decoder, loop.wire)
    return loop


def arrive(loop: LoopMemory, data: bytes, now: int) -> int:
    """Has an assembled loop take these bytes as if they had arrived at a time of the test's own (ns); returns what the
    loop makes of them, a code of hapsim.loop.endings."""
    loop.inbox.bytes[: len(data)] = np.frombuffer(data, np.uint8)
    loop.inbox.start, loop.inbox.stop = 0, len(data)
    code, _ = _take_and_compose(loop.record, now)
    return int(code)
