"""The loop of several ports without a session: mocks in virtual time, in memory or on pseudo-terminals."""

from __future__ import annotations

import contextlib
from dataclasses import dataclass
from typing import Any

from firmware_protocol import schema
from hapsim.compiling.kept import compile_for
from hapsim.device.connection import arm, describe
from hapsim.device.open_connection import TransportKind, open_connection
from hapsim.loop import endings
from hapsim.loop.joint_loop import run_loops
from hapsim.recording.recorder import Recorder
from hapsim.recording.trace import Trace
from hapsim.running import Excitation, outcome
from hapsim.running.assemble_joint import JointMemory
from hapsim.running.assemble_loop import LoopMemory, assemble_loop
from hapsim.running.requirements import PACING
from hapsim.running.session_options import RunOptions
from hapsim.scene import Scene
from tests.port_scenes import two_devices

FINE = {"quantum": 1e-10, "force_quantum": 1e-9}


@dataclass(frozen=True)
class JointRun:
    """A run that has ended, by the names of the ports."""

    traces: dict[str, Trace]
    endings: dict[str, int]
    loops: dict[str, LoopMemory]
    released: tuple[str, ...]
    """Names of the ports whose device is disarmed."""


def virtual_scene(
    stiffness: float = 2000.0,
    damping: float = 5.0,
    *,
    phase: float = 0.0,
    ppm: float = 0.0,
    device: dict[str, Any] | None = None,
    left: dict[str, Any] | None = None,
    mock: dict[str, Any] = FINE,
    **changes: Any,
) -> Scene:
    """Returns two hands on one spring in virtual time. `phase`, `ppm`: of the clock of the right one. `device`, `mock`:
    more keys of both devices and mocks, `left` of the left device."""
    both = {"mass": 0.2, "friction": 1.0, "clock": "lockstep", "delay": 1.0} | (device or {})
    spring = {"type": "viscoelastic", "between": ["a", "b"], "stiffness": stiffness, "damping": damping}
    points = {name: {"type": "device", "of": of, "channel": 0} for name, of in (("a", "left"), ("b", "right"))}
    clock = {"clock_ppm": ppm, "phase": phase}
    return two_devices(
        **{
            "devices": {"left": both | (left or {}), "right": both},
            "mocks": {"left": mock, "right": mock | clock},
            "modules": points | {"spring": spring},
        }
        | changes
    )


def run_ports(
    scene: Scene,
    duration: float,
    pushed: dict[str, Excitation] | None = None,
    *,
    transport: TransportKind = "auto",
    judges_energy: bool = False,
) -> JointRun:
    """Runs all ports for `duration` seconds."""
    scenes = {name: scene.at_port(name) for name in scene.ports}
    with contextlib.ExitStack() as stack:
        connections = {name: stack.enter_context(open_connection(one, transport)) for name, one in scenes.items()}
        described = {name: describe(one) for name, one in connections.items()}
        loops = {}
        for name, one in scenes.items():
            excitation = (pushed or {}).get(name)
            options = RunOptions(duration=duration, excitation=excitation, judges_energy=judges_energy)
            loops[name] = assemble_loop(one, connections[name], described[name], options)
        joint = JointMemory(scenes, loops)
        compile_for(run_loops, joint.record)
        recorders = {name: Recorder(loop.ring, keep=True) for name, loop in loops.items()}
        for name, loop in loops.items():
            pacing = PACING[scenes[name].device.clock]
            arm(connections[name], described[name], pacing, loop.watchdog_samples, loop.wire.parts)
        while run_loops(joint.record) == endings.RING_FULL:
            for one in recorders.values():
                one.collect()
        for one in recorders.values():
            one.collect()
        idle = (schema.IDLE, schema.LATCHED)
        released = tuple(name for name, one in connections.items() if one.mock.board.state in idle)
        ended = {name: joint.ending(name) for name in scenes}
        traces = {name: outcome.trace_of(scenes[name], loops[name], recorders[name], ended[name]) for name in scenes}
    return JointRun(traces, ended, loops, released)


def push(force: float, ticks: int = 20, start: int = 10) -> Excitation:
    """Returns one push."""
    return Excitation(0, force, ticks, every=1 << 30, start=start, first=False)
