"""Assembling the loop of several ports, from the loop of each."""

from __future__ import annotations

from collections.abc import Mapping

from firmware_protocol.compiled import new_record
from hapsim.compiling.native import address_of
from hapsim.errors import UsageError
from hapsim.loop.away import MOST_PORTS
from hapsim.loop.endings import RUNNING
from hapsim.loop.exchange import DEVICE_CLOCK, HOST_CLOCK
from hapsim.loop.joint_loop import JOINT, release_hook
from hapsim.loop.port_clock import set_clock
from hapsim.loop.system import require_linux
from hapsim.running.assemble_loop import LoopMemory
from hapsim.scene import Scene
from hapsim.scene.at_port import AwayPoint


class JointMemory:
    """The loop of several ports, ready to run, with everything that must stay in memory meanwhile."""

    def __init__(self, scenes: Mapping[str, Scene], loops: Mapping[str, LoopMemory]) -> None:
        """`scenes`: at each port, by name. `loops`: from `assemble_loop` of these."""
        require_linux("a scene with several devices", "use a device for each scene")
        if len(loops) > MOST_PORTS:
            raise UsageError(f"devices: found {len(loops)}, expected at most {MOST_PORTS}")
        self.record = new_record(JOINT)
        """JOINT of hapsim.loop.joint_loop."""
        self._scenes, self._loops, self._names = dict(scenes), dict(loops), list(loops)
        self.record.count, self.record.clock = len(loops), next(iter(loops.values())).control.clock
        for name, loop in self._loops.items():
            self._set_port(name, loop)
        for name in self._names:
            self._tie(name)

    def ending(self, name: str) -> int:
        """Returns RUNNING, or the code that ended a port."""
        return int(self.record.ports[self._names.index(name)].ending)

    def _set_port(self, name: str, loop: LoopMemory) -> None:
        port, scene = self.record.ports[self._names.index(name)], self._scenes[name]
        mock = scene.mock_device
        port.loop, port.ending = address_of(loop.record), RUNNING
        follows = self.record.clock == DEVICE_CLOCK
        is_apart = not follows and self.record.clock != HOST_CLOCK
        ppm, first = (mock.clock_ppm, mock.phase * 1e9 / scene.rate) if is_apart else (0.0, 0.0)
        set_clock(port.clock, rate_hz=scene.rate, follows=follows, first_ns=first, ppm=ppm)
        loop.set_hooks([release_hook(port), *loop.hooks])

    def _tie(self, name: str) -> None:
        """Fills what a port takes from others, and what these publish for it."""
        port = self.record.ports[self._names.index(name)]
        for i, one in enumerate(self._scenes[name].away):
            port.of_port[i], port.of_point[i] = self._names.index(one.port), self._published(one)

    def _published(self, one: AwayPoint) -> int:
        """Returns the number of a point among those that its port publishes, where it is put if it is new."""
        port, program = self.record.ports[self._names.index(one.port)], self._loops[one.port].program
        hand = self._scenes[one.port].device_points.get(one.point)
        channel, number = (-1, program.numbers[one.point]) if hand is None else (hand.channel, 0)
        points = port.points[: port.count]
        for k, point in enumerate(points):
            if (point.channel, point.number) == (channel, number):
                return k
        point = port.points[port.count]
        point.channel, point.number = channel, number
        if hand is None:
            point.position = program.rows[0][number]
        port.count += 1
        return int(port.count) - 1
