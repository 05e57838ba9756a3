"""Feel of first_touch through each build of the reference firmware, measured and predicted."""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[2]
BOARDS = ("linux", "avr", "cortex_m")
ROW = "| {board} | {k:.8g} | {k_off:+.1e} | {b:.8g} | {b_off:+.1e} | {rate:.0f} Hz | {misses} |"


def touch(board: str, duration_s: float, scene: Path) -> tuple[dict[str, Any], str] | None:
    """Returns the document of `hapsim measure` and what the board printed at its end; None where it is not built."""
    command = [str(ROOT / "firmware_protocol/firmware/board"), board]
    running = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    assert running.stdout is not None
    port = running.stdout.readline().strip()
    try:
        if not port:
            return None
        words = ["measure", scene, "--port", port, "--duration", duration_s, "--json"]
        measured = subprocess.run(
            [sys.executable, "-m", "hapsim", *map(str, words)], capture_output=True, text=True, check=False
        )
    finally:
        running.terminate()
        text = running.communicate()[1]
    if measured.returncode != 0:
        raise SystemExit(f"{board}: hapsim measure ended with status {measured.returncode}: {measured.stderr[-500:]}")
    return json.loads(measured.stdout), text


def row(board: str, document: dict[str, Any]) -> str:
    predicted, measured = document["predicted"], document["measured"]
    return ROW.format(
        board=board,
        k=measured["k"],
        k_off=measured["k"] / predicted["k"] - 1.0,
        b=measured["b"],
        b_off=measured["b"] / predicted["b"] - 1.0,
        rate=document["rate_hz"],
        misses=f"{document['deadline_misses']} of {document['ticks']}",
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--duration", type=float, default=2.0, help="seconds of each touch (2)")
    parser.add_argument(
        "--scene", type=Path, default=ROOT / "configs/first_touch.yaml", help="(configs/first_touch.yaml)"
    )
    options = parser.parse_args()
    print("| board | measured k, N/m | off by | measured b, N·s/m | off by | rate reached | deadline misses |")
    print("|---|---|---|---|---|---|---|")
    notes, predicted = [], None
    for board in BOARDS:
        touched = touch(board, options.duration, options.scene)
        if touched is None:
            print(f"{board}: not built on this machine", file=sys.stderr)
            continue
        document, text = touched
        predicted = document["predicted"]
        print(row(board, document), flush=True)
        notes += [line for line in text.splitlines() if "cycles" in line or "interrupt" in line or "main loop" in line]
    if predicted is not None:
        print(f"\nPredicted: k = {predicted['k']:.8g} N/m, b = {predicted['b']:.8g} N·s/m.")
    if notes:
        print("\n" + "\n".join(notes))


if __name__ == "__main__":
    main()
