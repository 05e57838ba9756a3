"""A Haply as a program meets it: the mock board, the bridge in front of it, and a host that pushes."""

from __future__ import annotations

import subprocess
import time
from collections.abc import Iterable
from pathlib import Path
from typing import IO, Any

from firmware_protocol import schema
from hapsim.bringup.probe.probing import Sample, Session, Wire, arm
from hapsim.device.connection import describe
from hapsim.device.ports import open_serial_port

PUSH = (30_000_000, -20_000_000)  # counts: 0.3 N and -0.2 N, for which no torque is near the motors' limit
FIRST = ("nice", "-n", "-15")  # before other programs of this machine, where that is granted
PATIENCE_S = 60.0  # for a machine that hangs


class Bridged:
    """The mock, its log and the bridge; `options` as the mock takes them."""

    def __init__(self, built: Path, to: Path, options: Iterable[str] = (), model: str = "v3") -> None:
        self.log, self.said = to / "torques.log", to / "bridge.err"
        self.mock = self._started(None, built / "mock_haply", self.log, *options)
        self.board = self._path(self.mock)
        with self.said.open("w") as err:
            self.bridge = self._started(err, built / "haply", self.board, model)
        self.port = self._path(self.bridge)

    @staticmethod
    def _started(err: IO[str] | None, *command: str | Path) -> subprocess.Popen[str]:
        return subprocess.Popen([*FIRST, *command], stdout=subprocess.PIPE, stderr=err, text=True)

    @staticmethod
    def _path(process: subprocess.Popen[str]) -> str:
        assert process.stdout is not None
        return process.stdout.readline().strip()

    def torques(self) -> list[tuple[int, float, float]]:
        """Each frame of torques: nanoseconds of time.monotonic_ns, N·m of port 1 and 2."""
        lines = self.log.read_text("ascii").splitlines(keepends=True)
        words = [line.split() for line in lines if line.endswith("\n")]
        return [(int(at), float(one), float(two)) for at, one, two in words]

    def wait_until(self, what: Any) -> None:
        """Until `what()` is true. The minute is for a machine that hangs."""
        give_up = time.monotonic() + PATIENCE_S
        while not what():
            assert time.monotonic() < give_up, f"not within a minute; the bridge said: {self.said.read_text()}"
            time.sleep(0.005)

    def is_released(self) -> bool:
        """True if the last torques of the log are zero."""
        torques = self.torques()
        return bool(torques) and abs(torques[-1][1]) < 1e-30 and abs(torques[-1][2]) < 1e-30

    def stop(self) -> None:
        for process in (self.bridge, self.mock):
            process.kill()
            process.wait()
            assert process.stdout is not None
            process.stdout.close()


class Pushing:
    """A host that paces, and answers every position with one force, for as long as a force may live."""

    def __init__(self, port: str, counts: tuple[int, int] = PUSH) -> None:
        self.connection = open_serial_port(port, 2_000_000)
        self.counts, self.wire = counts, Wire(self.connection)
        self.session: Session = arm(self.wire, describe(self.connection), schema.PACED_BY_HOST, 2047)

    def run(self, samples: int) -> bool:
        """Returns whether so many positions came."""
        if self.session.newest is not None:
            self.push(self.session.newest)
        return self.session.run(samples, self.push)

    def push(self, sample: Sample) -> None:
        self.session.force(sample.n, self.counts)

    def close(self) -> None:
        self.connection.close()
