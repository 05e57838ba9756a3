"""Every live value of every shipped scene, changed by a client, saved, and read back by a new run.

    tools/bench/saved [--scenes NAME,...]

`hapsim run --serve` runs each scene on the mock in virtual time from a copy of its file. A client
of the WebSocket changes one parameter after the other, as the page's sliders do, and saves after each. After the last
one, a new run of the file is asked for its model: each value is compared with the one that ran. The lines of the file
are compared with those before: comments, keys, and lines that hold no changed value.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import re
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from websockets.sync.client import connect

CONFIGS = Path(__file__).resolve().parents[2] / "configs"


class Client:
    """A client of the WebSocket."""

    def __init__(self, socket: Any) -> None:
        self._socket, self._asked = socket, 0

    def ask(self, **message: Any) -> dict[str, Any]:
        """Returns the answer to a request."""
        self._asked += 1
        self._socket.send(json.dumps(message | {"id": self._asked}))
        while True:
            answer: dict[str, Any] = json.loads(self._socket.recv(timeout=120))
            if answer.get("id") == self._asked:
                return answer


@contextlib.contextmanager
def served(path: Path) -> Iterator[Client]:
    """Runs the scene of a file with `hapsim run`, and yields a client once it runs."""
    command = [sys.executable, "-m", "hapsim", "run", path.name, "--serve-at", "127.0.0.1:0"]
    environment = os.environ | {"XDG_STATE_HOME": str(path.parent)}
    with subprocess.Popen(
        command, cwd=path.parent, env=environment, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True
    ) as process:
        assert process.stderr is not None
        found = next(found for line in process.stderr if (found := re.search(r"http://([^/\s\"]+)/", line)))
        listener = threading.Thread(target=process.stderr.read)
        listener.start()
        with connect(f"ws://{found[1]}/live", origin=f"http://{found[1]}", max_size=None) as socket:  # type: ignore[arg-type]
            client = Client(socket)
            while client.ask(type="get")["phase"] != "running":
                time.sleep(0.05)
            yield client
            client.ask(type="stop")
        listener.join()


def values_to_try(one: dict[str, Any]) -> Iterator[Any]:
    """Yields values that a parameter may have next."""
    value = one["value"]
    if one["kind"] == "word":
        yield from (word for word in one["words"] if word != value)
    elif one["kind"] == "number":
        low, high = one["span"]
        yield from (float(f"{value * factor:.4g}") for factor in (1.25, 0.8) if value)
        shares = (0.01, 0.05, 0.3) if low == 0.0 else (0.51, 0.45, 0.3)
        yield from (float(f"{low + (high - low) * share:.4g}") for share in shares)
    elif one["kind"] == "numbers":
        yield [float(f"{x * 1.25 + 0.01:.4g}") for x in value]
    else:
        yield weaker(value)


def weaker(points: Any) -> Any:
    """Returns a curve with less force."""
    if isinstance(points, dict):
        return {key: weaker(one) if isinstance(one, list) else one for key, one in points.items()}
    return [[x, 0.9 * force] for x, force in points]


def change_and_save(client: Client) -> tuple[dict[str, Any], int, int, int]:
    """Changes each parameter and saves. Returns the values at the end, how many parameters were changed, had no other
    possible value, and were refused by themselves."""
    changed = unchanged = refused = 0
    parameters = client.ask(type="get")["parameters"]
    for one in sorted(parameters, key=lambda one: one["name"] == "mock.hand.force"):  # last: its spring holds it then
        for value in values_to_try(one):
            if client.ask(type="set", values={one["name"]: value}, over=0.05)["type"] == "done":
                changed += 1
                saved = client.ask(type="save")
                if saved["type"] == "rejected":
                    refused += 1
                    assert "by an anchor" in saved["reason"], saved["reason"]
                break
        else:
            unchanged += 1
    last = client.ask(type="save")
    assert last["type"] == "done", last
    return {one["name"]: one["value"] for one in client.ask(type="get")["parameters"]}, changed, unchanged, refused


def lines_that_differ(before: str, after: str, names: set[str]) -> tuple[int, list[str]]:
    """Returns how many lines differ, and those of them that should not."""
    may, count, wrong = {part for name in names for part in name.split(".")} | {"press", "release"}, 0, []
    new = after.splitlines()
    if len(new) > len(before.splitlines()):  # the hand of the mock
        new = [line for line in new if not re.match(r"(mock: \{|  )hand: \{(force|stiffness|position): ", line)]
    for old, now in zip(before.splitlines(), new, strict=True):
        if old == now:
            continue
        had, has = (re.findall(r"[\w-]+(?=:)", one.partition("#")[0]) for one in (old, now))
        is_right = old.partition("#")[2] == now.partition("#")[2] and [key for key in has if key in had] == had
        count, wrong = count + 1, wrong + ([] if is_right and {*has} - {*had} <= may and {*had} & may else [now])
    return count, wrong


def main() -> int:
    parser = argparse.ArgumentParser("tools/bench/saved", description=__doc__)
    parser.add_argument("--scenes", default="")
    chosen = [name for name in parser.parse_args().scenes.split(",") if name]
    failures = total = 0
    print("| scene | changed | no other possible | refused alone (anchors) | read back equal | lines changed | wrong |")
    print("|---|---|---|---|---|---|---|")
    with tempfile.TemporaryDirectory() as folder:
        for shipped in sorted(CONFIGS.glob("*.yaml")):
            if chosen and shipped.stem not in chosen:
                continue
            before = re.sub(r"clock: (device|host)", "clock: lockstep", shipped.read_text(encoding="utf-8"))
            path = Path(folder, shipped.name)
            path.write_text(before, encoding="utf-8")
            with served(path) as client:
                live, changed, unchanged, refused = change_and_save(client)
            with served(path) as client:
                again = {one["name"]: one["value"] for one in client.ask(type="get")["parameters"]}
            lines, wrong = lines_that_differ(before, path.read_text(encoding="utf-8"), {*live})
            equal = sum(again.get(name) == value for name, value in live.items())
            failures += equal != len(live) or bool(wrong)
            total += changed
            cells = shipped.stem, changed, unchanged, refused, f"{equal} of {len(live)}", lines, len(wrong)
            print(f"| {' | '.join(map(str, cells))} |", flush=True)
            for line in wrong:
                print(f"WRONG: {line}", file=sys.stderr)
    print(f"{total} values changed and saved; {failures} scenes differ")
    return 1 if failures else 0


if __name__ == "__main__":
    sys.exit(main())
