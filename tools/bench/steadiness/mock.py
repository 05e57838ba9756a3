"""The device that the loops run against: `hapsim mock`, in a process of its own."""

from __future__ import annotations

import contextlib
import re
import select
import sys
from collections.abc import Iterable, Iterator
from pathlib import Path

from steadiness.processes import PeerError, end, running

FIRST_TOUCH = Path(__file__).resolve().parents[3] / "configs" / "first_touch.yaml"
_START_S = 120.0  # the first time it is compiled


def scene_with_clock(clock: str, directory: Path) -> Path:
    """first_touch with another clock, written there."""
    path = directory / f"{clock}.yaml"
    text, found = re.subn(r"(?m)^  clock: \w+", f"  clock: {clock}", FIRST_TOUCH.read_text(encoding="utf-8"))
    if found != 1:
        raise PeerError(f"{FIRST_TOUCH}: found {found} lines with a clock, expected 1")
    path.write_text(text, encoding="utf-8")
    return path


@contextlib.contextmanager
def mock_device(scene: Path, cpus: Iterable[int]) -> Iterator[str]:
    """The path of its port, as long as the with-block lasts. `cpus`: where it runs."""
    with running([sys.executable, "-m", "hapsim", "mock", str(scene)], cpus=cpus) as process:
        assert process.stdout is not None
        ready, _, _ = select.select([process.stdout], [], [], _START_S)
        path = process.stdout.readline().strip() if ready else ""
        if not path:
            raise PeerError(f"hapsim mock {scene}: {end(process)[1].strip() or 'no port within two minutes'}")
        yield path
