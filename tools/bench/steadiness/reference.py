"""The C loop: built once, for this machine."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

SOURCE = Path(__file__).resolve().parents[1] / "reference_loop.c"
FLAGS = ["-std=c11", "-O3", "-march=native", "-ffp-contract=off", "-pthread"]


def build_reference(directory: Path) -> tuple[Path | None, str]:
    """(The program, by which compiler), or (None, why there is none)."""
    compiler = shutil.which("cc")
    if compiler is None:
        return None, "There is no C compiler (cc) here: the C loop is not measured."
    program = directory / "reference_loop"
    command = [compiler, *FLAGS, "-o", str(program), str(SOURCE), "-lm"]
    built = subprocess.run(command, capture_output=True, text=True, check=False)
    if built.returncode != 0:
        return None, f"The C loop does not compile here and is not measured: {built.stderr.strip().splitlines()[0]}"
    version = subprocess.run([compiler, "--version"], capture_output=True, text=True, check=False).stdout
    return program, f"{version.splitlines()[0]}, {' '.join(FLAGS)}"
