"""Our compiled functions, looked up once, and an empty cache."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

import firmware_protocol
import hapsim
from hapsim.compiling import kept

sys.path.insert(0, str(Path(__file__).parent))
from small_functions import as_another_process

# Where they are imported from: the clone, or an installation that these tests are run against.
PACKAGES = tuple(Path(package.__file__).resolve().parent for package in (hapsim, firmware_protocol))
TOOLS = Path(__file__).resolve().parents[2] / "tools" / "bench"


@dataclass(frozen=True)
class Compiled:
    """A function that numba compiles, or that tells numba how."""

    kind: str
    """entry, native, piece, overload; intrinsic, lowering: those that write instructions themselves."""
    name: str
    file: Path
    line: int
    reached: frozenset[Path]
    """Source files of the machine code, for an entry and a native function."""

    def __str__(self) -> str:
        return f"{self.file}:{self.line} {self.name}"


@pytest.fixture(scope="session")
def every_compiled() -> list[Compiled]:
    """All of them, in both packages and in the benches."""
    program = Path(__file__).with_name("what_is_compiled.py")
    command = [sys.executable, str(program), *map(str, (*PACKAGES, TOOLS))]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    document: dict[str, Any] = json.loads(done.stdout)
    # Only others' modules may be missing: then every file of ours was imported but those that need them.
    ours = {folder.name for folder in PACKAGES} | {path.stem for path in TOOLS.iterdir()}
    assert [name for _, name in document["missing"] if name.partition(".")[0] in ours] == []
    return [
        Compiled(one["kind"], one["name"], Path(one["file"]), one["line"], frozenset(map(Path, one.get("reached", ()))))
        for one in document["functions"]
    ]


@pytest.fixture
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """An empty cache of this test's own."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.delenv("HAPSIM_CACHE", raising=False)
    monkeypatch.setattr(kept, "_unkept", [])
    as_another_process()
    yield tmp_path
    as_another_process()
