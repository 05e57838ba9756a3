"""Time from a message that changes a parameter to the loop's mailbox, which its next sample reads.

    tools/bench/message [--changes 60] [--walls 80] [--beside CHECKOUT] [--unstable] [--processor] [SCENE ...]
    tools/bench/message --verdicts 2000 [--first 0]

`hapsim run` of each shipped scene on the mock, and of a maze, in real time. A WebSocket client sets each live number in
turn to 1.01 and 0.99 times its value, and a position to a place 10 µm away. After each it asks for a prediction of
another value, as the page does. With --beside another version of hapsim runs in turns with this one. --processor: the
processor time of `Session.set` in place of the time to the answer, in virtual time, for a machine with other work.
--verdicts judges random changes of random scenes as a run does, and again from nothing.
"""

from __future__ import annotations

import argparse
import contextlib
import itertools
import json
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterable, Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any, NamedTuple

from panel import ask, connect_here, origin_of, served
from walls import scene_of

import hapsim
from hapsim.errors import UsageError

ROOT = Path(__file__).resolve().parents[2]
STEP_M, CHANGES = 1e-5, 2  # of each scene that is judged again


class Times(NamedTuple):
    """Milliseconds from request to answer, each with its parameter."""

    changes: list[tuple[float, str]]
    predictions: list[tuple[float, str]]


def timed(client: Any, message: dict[str, Any]) -> tuple[float, dict[str, Any]]:
    """Returns the milliseconds until the answer, and the answer."""
    begin = time.perf_counter()
    answer = json.loads(ask(client, message))
    return 1e3 * (time.perf_counter() - begin), answer


def steps(parameters: Iterable[Any], count: int) -> Iterator[tuple[str, float]]:
    """Yields changes of the live numbers in turn: name and new value."""
    numbers = [one for one in parameters if one.kind == "number" and not one.name.startswith("mock.")]
    for number, one in zip(range(count), itertools.cycle(numbers), strict=False):
        side = 1.0 if number // len(numbers) % 2 == 0 else -1.0
        is_place = one.unit in ("m", "rad") or not one.value
        yield one.name, one.value + side * (STEP_M if is_place else 0.01 * one.value)


def times_of(scene: str, changes: int, *options: str) -> Times:
    """Runs a scene, and changes its parameters one after the other."""
    found = Times([], [])
    with contextlib.ExitStack() as stack:
        directory = stack.enter_context(tempfile.TemporaryDirectory())
        url, *_ = stack.enter_context(served(Path(directory), "--realtime", *options, scene=scene))
        client = stack.enter_context(connect_here(url, origin=origin_of(url)))
        parameters = json.loads(ask(client, {"type": "get"}))["parameters"]
        every = [SimpleNamespace(**{key: one[key] for key in ("name", "kind", "unit", "value")}) for one in parameters]
        for (name, value), (_, other) in itertools.pairwise(steps(every, changes + 1)):
            for type_, asked, times in (("set", value, found.changes), ("predict", other, found.predictions)):
                took, answer = timed(client, {"type": type_, "values": {name: asked}})
                if answer["type"] in ("done", "predicted"):
                    times.append((took, name))
            time.sleep(0.02)
    return found


def processor_times_of(scene: str, changes: int, is_unstable: bool) -> Times:
    """Changes the parameters of a scene in virtual time, in this process."""
    found, parsed = Times([], []), hapsim.parse_scene(scene)
    device = parsed.device.model_copy(update={"clock": "lockstep", "port": None})
    with hapsim.start(parsed.model_copy(update={"device": device}), transport="mock", unstable=is_unstable) as session:
        for name, value in steps(session.parameters.values(), changes):
            part, _, key = name.rpartition(".")
            begin = time.thread_time()
            with contextlib.suppress(UsageError):  # it is predicted unstable
                session.set({part: {key: value}})
                found.changes.append((1e3 * (time.thread_time() - begin), name))
    return found


def row(name: str, times: Times) -> str:
    """Returns a row of the table."""
    cells = []
    for each in times:
        middle = statistics.median(took for took, _ in each) if each else float("nan")
        worst, of = max(each, default=(float("nan"), "none"))
        cells += [f"{middle:.1f}", f"{worst:.1f} ({of})"]
    return f"| {name} | {' | '.join(cells)} |"


def main() -> int:
    parser = argparse.ArgumentParser(
        "tools/bench/message", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("scenes", nargs="*", metavar="SCENE", help="[default: all that ship, and the maze]")
    parser.add_argument("--changes", type=int, default=60, help="of each scene")
    parser.add_argument("--walls", type=int, default=80, help="of the maze")
    parser.add_argument("--beside", type=Path, help="a checkout of another version, with its .venv")
    parser.add_argument("--unstable", action="store_true")
    parser.add_argument("--processor", action="store_true")
    parser.add_argument("--verdicts", type=int, help="number of scenes")
    parser.add_argument("--first", type=int, default=0)
    arguments = parser.parse_args()
    if arguments.verdicts:
        from tests.changed_scenes import unlike_verdicts  # another version may not have it

        made = [unlike_verdicts(seed, CHANGES) for seed in range(arguments.first, arguments.first + arguments.verdicts)]
        unlike = [one for *_, each in made for one in each]
        verdicts, refused = sum(one[0] for one in made), sum(one[1] for one in made)
        print(f"{verdicts} verdicts, {refused} of them refusals: {len(unlike)} differ from those found from nothing")
        print("\n".join(unlike), end="\n" if unlike else "")
        return len(unlike) > 0
    paths = [Path(one) for one in arguments.scenes] or sorted((ROOT / "configs").glob("**/*.yaml"))
    scenes = {one.stem: one.read_text("utf-8") for one in paths if "modules:" in one.read_text("utf-8")}
    scenes |= {} if arguments.scenes else {f"maze of {arguments.walls} walls": scene_of(arguments.walls)}
    print("| scene | a change, ms, p50 | most | a prediction, p50 | most |\n|---|---|---|---|---|", flush=True)
    for name, text in scenes.items():
        options = ["--unstable"] * arguments.unstable
        if arguments.processor:
            times = processor_times_of(text, arguments.changes, arguments.unstable)
        else:
            times = times_of(text, arguments.changes, *options)
        print(row(name, times), flush=True)
        if arguments.beside:
            with tempfile.NamedTemporaryFile("w", suffix=".yaml") as file:
                file.write(text)
                file.flush()
                command = [arguments.beside / ".venv/bin/python", __file__, file.name, *options]
                command += ["--changes", str(arguments.changes), *["--processor"] * arguments.processor]
                lines = subprocess.run(
                    command, check=True, cwd=arguments.beside, capture_output=True, text=True
                ).stdout.splitlines()
                print(f"| … {arguments.beside.name}{lines[-1][lines[-1].index(' |') :]}", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
