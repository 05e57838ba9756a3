"""The file that a run leaves if a guard, a fault of the device or a lost device ended it: a zip of plain members.

report.json              the sentence, the report's numbers, what the device said of itself
frames_from_device.bin   the last hundred frames and what stood between them, as on the wire
frames_to_device.bin     the same the other way; the last of them may not have left
trace.npz                the last second, as `hapsim.load_trace` reads it
scene.yaml               the scene as it ran, changes included
"""

from __future__ import annotations

import contextlib
import io
import itertools
import json
import os
import re
import zipfile
from dataclasses import asdict
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, NamedTuple

from firmware_protocol.description import Description, to_registers
from hapsim.device.ports import state_directory
from hapsim.errors import RunError, UsageError
from hapsim.loop.buffers import KEPT
from hapsim.recording.trace import IN_REPORT, ZIP_WITHOUT_END, Trace, is_without_end
from hapsim.scene import Scene

NEWEST = 20
"""Reports that stay in a directory; older ones are removed."""
FRAMES = 100
"""Frames that are kept each way."""

_NAME = re.compile(r"\d{8}T\d{6}Z_.*\.zip")
_ABOUT, _FROM_DEVICE, _TO_DEVICE, _SCENE = "report.json", "frames_from_device.bin", "frames_to_device.bin", "scene.yaml"


class WireBytes(NamedTuple):
    """The bytes on the wire, each way."""

    from_device: bytes
    to_device: bytes


class StopReport(NamedTuple):
    """A report file, read; its trace is `load_trace`'s."""

    about: dict[str, Any]
    """report.json"""
    wire: WireBytes


def default_directory() -> Path:
    """Returns the directory of the reports of runs on a port: $XDG_STATE_HOME/hapsim/reports, by default under
    ~/.local/state. Raises OSError if the user has no home."""
    return state_directory() / "reports"


def write_report(
    directory: Path, name: str, failure: RunError, trace: Trace, scene: Scene, description: Description, wire: WireBytes
) -> Path:
    """Writes the report of a run that ended in `failure`, and removes all but the NEWEST. Returns its path. `name`: the
    user's name of the port; `trace`: its last second. OSError where it cannot be written."""
    now = datetime.now(UTC)
    about = {
        "sentence": str(failure),
        "exit_status": failure.exit_status,
        "port": name,
        "when": now.isoformat(),
        "report": asdict(trace.report),
        "registers": {number: int(value) & 0xFFFFFFFF for number, value in enumerate(to_registers(description))},
    }
    rows = io.BytesIO()
    trace.write_npz(rows)
    members: dict[str, str | bytes] = {
        _ABOUT: json.dumps(about, indent=2),
        _FROM_DEVICE: last_frames(wire.from_device),
        _TO_DEVICE: last_frames(wire.to_device),
        IN_REPORT: rows.getvalue(),
        _SCENE: scene.to_yaml(),
    }
    directory.mkdir(parents=True, exist_ok=True)
    ending = trace.report.ending
    if ending in ("done", "stopped"):  # a run that ended as asked for has a report for one of these
        ending = "without force" if trace.report.released else "not released"
    words = (name.removeprefix("/dev/"), ending)
    port, ending = (re.sub(r"[^A-Za-z0-9.]+", "-", word).strip("-") for word in words)
    name = f"{now:%Y%m%dT%H%M%SZ}_{port[-40:]}_{ending}"
    paths = (directory / f"{name}{f'_{number}' if number > 1 else ''}.zip" for number in itertools.count(1))
    path = next(path for path in paths if not path.exists())
    unfinished = path.with_suffix(f".{os.urandom(8).hex()}")  # under its name it is whole, or not there
    try:
        with zipfile.ZipFile(unfinished, "w", zipfile.ZIP_DEFLATED) as file:
            for member, content in members.items():
                file.writestr(member, content)
        os.replace(unfinished, path)
    finally:
        with contextlib.suppress(OSError):
            unfinished.unlink()
    remove_older(directory, _NAME)
    return path


def remove_older(directory: Path, name: re.Pattern[str]) -> None:
    """Removes the files with such a name, which begins with the time, but the NEWEST."""
    for older in sorted(path for path in directory.iterdir() if name.fullmatch(path.name))[:-NEWEST]:
        with contextlib.suppress(OSError):
            older.unlink()


def is_report(path: Path) -> bool:
    """Returns True for a report file. Raises OSError if it cannot be read, UsageError for another zip, or one that is
    damaged or cut short."""
    if is_without_end(path):
        raise UsageError(f"{path}: {ZIP_WITHOUT_END}")
    if not zipfile.is_zipfile(path):
        return False
    try:
        with zipfile.ZipFile(path) as file:
            missing = {_ABOUT, _FROM_DEVICE, _TO_DEVICE} - set(file.namelist())
    except Exception as error:  # zipfile raises what it likes of a damaged file
        raise UsageError(f"{path}: a damaged zip ({error})") from error
    if missing:
        raise UsageError(
            f"{path}: found a zip file without {min(missing)}, expected a report file of hapsim or raw bytes of the "
            "wire; what a .npz has recorded, `hapsim chart trace` draws"
        )
    return True


def read_report(path: Path) -> StopReport:
    """Reads a report file. Raises UsageError if it is none."""
    try:
        with zipfile.ZipFile(path) as file:
            wire = WireBytes(file.read(_FROM_DEVICE), file.read(_TO_DEVICE))
            about = json.loads(file.read(_ABOUT))
        missing = {"sentence", "port", "when", "registers"} - set(about)
        if missing:
            raise ValueError(f"{_ABOUT} has no {sorted(missing)[0]}")
        return StopReport(about, wire)
    except Exception as error:  # zipfile and zlib raise what they like of a damaged file
        raise UsageError(f"{path}: not a report of hapsim ({error})") from error


def last_frames(data: bytes) -> bytes:
    """Returns the last FRAMES frames and the bytes after them. If earlier bytes were dropped, the data may begin within
    a frame."""
    first = 0 if len(data) < KEPT else data.find(b"\0") + 1
    at = len(data)
    for _ in range(FRAMES + 1):
        at = data.rfind(b"\0", first, at)
        if at < 0:
            return data[first:]
    return data[at + 1 :]
