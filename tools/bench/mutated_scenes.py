"""Scene files with something wrong in them: each loads, or gives an error with its place. Never a traceback.

    tools/bench/mutated_scenes [damaged | odd] [--number 100000] [--from 0] [--seed 1] [--processes N]
                               [--every-check 1] [--every-run 1] [--json FILE] [--keep DIR]

`damaged`: shipped scenes are damaged at random: bytes flipped, cut, doubled and thrown in, lines moved, numbers made
extreme, words exchanged for others of the format, the file cut short.

`odd`: scenes that are valid in form. Of each shipped scene every number is replaced by each of VALUES and every word by
others of the format and by a list, one at a time; a hand on a wall has 400 frictions with each correction; each type of
module has units, and none. They come in the order of a seeded shuffle.

Each file is loaded in at most SECONDS of processor time and MEMORY of memory beyond what the process had, or it is a
finding. Of those that load every `--every-check`th goes through `hapsim check`, in at most CHECK seconds of processor
time, and every `--every-run`th is run in virtual time against the embedded mock. Both have to end with a status that
USING.md names (1, a defect, is a finding), a run within AT_MOST seconds of processor time, and numpy may not warn.
`--keep` writes the files with findings there.
"""

from __future__ import annotations

import argparse
import collections
import contextlib
import io
import json
import os
import random
import re
import resource
import signal
import sys
import tempfile
import time
import traceback
import warnings
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any, NamedTuple
from unittest import mock

import yaml

import hapsim
from hapsim.errors import HapsimError, SceneError
from hapsim.scene import Scene, scene_schema

SECONDS, MEMORY = 1.0, 1 << 30
CHECK = 20.0
AT_MOST = 120
MOST_SAMPLES = 1_000_000  # a second at more than this rate is as many samples
STATUSES = (0, 2, 3, 4)

CONFIGS = Path(__file__).resolve().parents[2] / "configs"
_NUMBER = re.compile(r"(?<![\w.])-?\d+(?:\.\d+)?(?:[eE][+-]?\d+)?")
_WORD = re.compile(r"[a-z][a-z_]+")
_NUMBERS = (
    "0 -0.0 -1 1 2 3 16 17 0.5 1e-300 1e-12 1e12 1e300 1e400 -1e300 .nan .inf -.inf 99999999999999999999 0x10 1_0"
)
_NUMBERS += " 4096 100000 1000000000 1.5 1e-9 '2' ~ true [] {} [1] {from: 0.1, to: 0.4}"
VALUES = (5e-324, 1e-12, 1e12, 1e308)
"""Beyond what scenes have; and usual ones."""
VALUES += (-1, -0.01, 0, 1e-6, 1e-4, 0.001, 0.002, 0.004, 0.01, 0.05, 0.2, 0.5, 1, 1.5, 2, 3, 10, 100, 1000, 20000)
_SCRAPS = [*":\n\t {}[]%\0\ufeffé\x85#'\"|", "- ", "&a ", "*a", "<<: *a", "!!"]


class Outcome(NamedTuple):
    """Result of a file."""

    name: str
    """refused, loaded, or what was done with it and how that ended."""
    finding: str
    """Defect, and the file that shows it; empty if there is none."""


def mutated(text: str, words: list[str], chance: random.Random) -> bytes:
    """A damaged scene: one to four things wrong."""
    for _ in range(chance.choice((1, 1, 1, 2, 2, 3, 4))):
        text = chance.choice(_MUTATIONS)(text, words, chance)
    data = bytearray(text, "utf-8")
    if chance.random() < 0.1 and data:
        for _ in range(chance.randint(1, 4)):
            data[chance.randrange(len(data))] = chance.randrange(256)
    return bytes(data)


def _exchange(pattern: re.Pattern[str], text: str, by: str, chance: random.Random) -> str:
    found = list(pattern.finditer(text))
    if not found:
        return text
    one = chance.choice(found)
    return text[: one.start()] + by + text[one.end() :]


def _other_number(text: str, _: list[str], chance: random.Random) -> str:
    return _exchange(_NUMBER, text, chance.choice(_NUMBERS.split(" ")), chance)


def _scaled_number(text: str, _: list[str], chance: random.Random) -> str:
    return _exchange(_NUMBER, text, f"{10 ** chance.uniform(-6, 6):.3g}", chance)


def _other_word(text: str, words: list[str], chance: random.Random) -> str:
    return _exchange(_WORD, text, chance.choice(words), chance)


def _scrap(text: str, _: list[str], chance: random.Random) -> str:
    at = chance.randint(0, len(text))
    return text[:at] + chance.choice(_SCRAPS) * chance.choice((1, 1, 1, 2, 100)) + text[at:]


def _cut(text: str, _: list[str], chance: random.Random) -> str:
    at = chance.randint(0, len(text))
    return text[:at] + text[at + chance.choice((1, 1, 2, 5, 20, 1000)) :]


def _doubled(text: str, _: list[str], chance: random.Random) -> str:
    at = chance.randint(0, len(text))
    return text[:at] + text[at : at + chance.randint(1, 60)] * 2 + text[at:]


def _lines(text: str, words: list[str], chance: random.Random) -> str:
    lines = text.split("\n")
    one, other = chance.randrange(len(lines)), chance.randrange(len(lines))
    kind = chance.randrange(4)
    if kind == 0:
        lines[one], lines[other] = lines[other], lines[one]
    elif kind == 1:
        lines.insert(other, lines[one])
    elif kind == 2:
        lines[one] = " " * chance.randint(0, 8) + lines[one].lstrip()
    else:
        lines.insert(one, f"{' ' * chance.randint(0, 6)}{chance.choice(words)}: {chance.choice(words)}")
    return "\n".join(lines)


_MUTATIONS = (_other_number, _other_number, _scaled_number, _scaled_number, _other_word, _scrap, _cut, _doubled, _lines)


def files(number: int, seed: int) -> Iterator[bytes]:
    """`number` damaged files, the same for the same seed."""
    texts = [path.read_text(encoding="utf-8") for path in sorted(CONFIGS.glob("*.yaml"))]
    words = sorted({word for text in texts for word in _WORD.findall(_without_comments(text))})
    for i in range(number):
        chance = random.Random(f"{seed} {i}")
        yield mutated(_without_comments(chance.choice(texts)), words, chance)


def _without_comments(text: str) -> str:
    return re.sub(r"(?m)^#.*\n|\s+#.*$", "", text)


def odd_files(seed: int) -> list[bytes]:
    """Scenes that are valid in form, in a shuffled order that depends on the seed alone."""
    paths = [*CONFIGS.glob("*.yaml"), *CONFIGS.glob("boards/*.yaml")]
    documents = [yaml.safe_load(path.read_text(encoding="utf-8")) for path in sorted(paths)]
    words = sorted(_words_of(scene_schema()))
    found = [one for document in documents for one in _with_other_values(document, words)]
    found += [*_frictions(), *_types(documents)]
    random.Random(seed).shuffle(found)
    return [json.dumps(one, ensure_ascii=False).encode() for one in found]


def _words_of(schema: Any) -> set[str]:
    """The words that a JSON schema lists as values."""
    if isinstance(schema, list):
        return set().union(*map(_words_of, schema))
    if not isinstance(schema, dict):
        return set()
    own = {one for one in (*schema.get("enum", ()), schema.get("const")) if isinstance(one, str)}
    return own.union(*map(_words_of, schema.values()))


def _with_other_values(document: Any, words: list[str]) -> Iterator[Any]:
    for path, value in _leaves(document, ()):
        unit = re.fullmatch(r"-?[\d.e+-]+( .+)", value) if isinstance(value, str) else None
        if unit or (isinstance(value, float | int) and path != ("version",)):
            others: list[Any] = [f"{one:.15g}{unit[1]}" if unit else one for one in VALUES]
            others += [[value], [value, value], {"from": value, "to": 2 * value}] if not unit else [[value]]
        else:
            others = [*words, [value], [value, value], {value: value}, 1.5]
        yield from (_replaced(document, path, one) for one in others)


def _leaves(value: Any, path: tuple[Any, ...]) -> Iterator[tuple[tuple[Any, ...], Any]]:
    if not isinstance(value, dict | list):
        yield path, value
        return
    for step, entry in value.items() if isinstance(value, dict) else enumerate(value):
        yield from _leaves(entry, (*path, step))


def _replaced(document: Any, path: tuple[Any, ...], by: Any) -> Any:
    if not path:
        return by
    copied = document.copy()
    copied[path[0]] = _replaced(document[path[0]], path[1:], by)
    return copied


def _frictions() -> Iterator[Any]:
    touch = {"type": "viscoelastic", "between": ["hand", "wall"], "stiffness": 1000, "damping": 10}
    modules = {"hand": {"type": "device", "channel": 0}, "wall": {"type": "ground"}, "touch": touch}
    for correction in ("none", "poles", "predictor", "adaptive", "sensed"):
        mass = {"from": 0.1, "to": 0.3} if correction == "adaptive" else 0.2
        for hundredths in range(400):
            device = {"mass": mass, "friction": hundredths / 100, "delay": 1, "correction": correction}
            device |= {"sensors": ["velocity", "acceleration"]} if correction == "sensed" else {}
            yield {"version": 1, "rate": 1000, "device": device, "modules": modules}


def _types(documents: list[Any]) -> Iterator[Any]:
    """Each module with its type in a list, missing, and exchanged, in a scene with a unit and in one without."""
    for document in documents:
        for name, module in document["modules"].items():
            for kind in ([module["type"]], ["a"], {}, None, "a", "2 N", 1, []):
                for mass in (0.2, "0.2 kg", "200 mm"):
                    device = ("device",) if "device" in document else ("devices", next(iter(document["devices"])))
                    own = document["device"] if "device" in document else document[device[0]][device[1]]
                    key = "mass" if "mass" in own else "simulated_mass"
                    with_mass = _replaced(document, (*device, key), mass)
                    yield _replaced(with_mass, ("modules", name, "type"), kind)


class TooSlowError(BaseException):
    """Nothing that hapsim catches."""


def _too_slow(_signal: int, _frame: object) -> None:
    raise TooSlowError


def tried(data: bytes, checks: bool = True, runs: bool = True, duration: float = 1.0) -> list[Outcome]:
    """Loads a file, and where it loads checks and runs it."""
    with tempfile.NamedTemporaryFile(suffix=".yaml") as file:
        file.write(data)
        file.flush()
        outcome, scene = _loaded(file.name)
        outcomes = [outcome]
        if scene is not None and checks:
            outcomes.append(_ended("check", lambda: _command("check", file.name), CHECK))
        if scene is not None and runs:
            outcomes.append(_ended("run", lambda: _run(scene, duration)))
    return outcomes


def _loaded(name: str) -> tuple[Outcome, Scene | None]:
    before = time.process_time()
    scene, finding, outcome = None, "", "refused"
    try:
        with _at_most(AT_MOST), _with_memory(MEMORY):
            scene = hapsim.load_scene(name)
        outcome = "loaded"
    except SceneError as error:
        misplaced = [line for line in str(error).splitlines() if not re.match(re.escape(name) + r":\d+:\d+: \S", line)]
        finding = f"an error without a place: {misplaced[0]}" if misplaced else ""
    except BaseException:
        outcome, finding = "failed", _last_words()
    took = time.process_time() - before
    if took > SECONDS and not finding:
        finding = f"took {took:.1f} s to load"
    return Outcome(outcome, finding), scene


def _ended(what: str, work: Any, most: float = AT_MOST) -> Outcome:
    try:
        with _at_most(most), contextlib.redirect_stderr(io.StringIO()) as errors, warnings.catch_warnings():
            warnings.simplefilter("always")
            status = work()
    except TooSlowError:
        return Outcome(f"{what}: hung", f"{what} took more than {most:g} s")
    except BaseException:
        return Outcome(f"{what}: failed", f"{what}: {_last_words()}")
    printed = errors.getvalue()
    if status not in STATUSES:
        return Outcome(f"{what}: {status}", f"{what} ended with status {status}: {printed[-500:]}")
    if "Traceback" in printed or "Warning:" in printed:
        return Outcome(f"{what}: {status}", f"{what} printed: {printed[-500:]}")
    return Outcome(f"{what}: {status}", "")


def _command(*arguments: str) -> int:
    """The exit status of the command, in this process."""
    from hapsim.cli import main

    with mock.patch.object(sys, "argv", ["hapsim", *arguments]), contextlib.redirect_stdout(io.StringIO()):
        try:
            main()
        except SystemExit as ending:
            return ending.code if isinstance(ending.code, int) else int(ending.code is not None)
    return 0


def _run(scene: Scene, duration: float) -> int:
    device = scene.device.model_copy(update={"clock": "lockstep", "port": None})
    duration = min(duration, MOST_SAMPLES / scene.rate)
    try:
        hapsim.run(scene.model_copy(update={"device": device}), duration=duration, transport="loopback", keep=False)
    except HapsimError as error:
        return error.exit_status
    return 0


def _last_words() -> str:
    return "".join(traceback.format_exc(limit=-4))[-1500:]


@contextlib.contextmanager
def _at_most(seconds: float) -> Iterator[None]:
    """So much processor time."""
    before = signal.signal(signal.SIGPROF, _too_slow)
    signal.setitimer(signal.ITIMER_PROF, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0.0)
        signal.signal(signal.SIGPROF, before)


@contextlib.contextmanager
def _with_memory(more: int) -> Iterator[None]:
    """So much address space beyond what is taken now."""
    taken = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    before = resource.getrlimit(resource.RLIMIT_AS)
    resource.setrlimit(resource.RLIMIT_AS, (taken + more, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_AS, before)


def _tried(task: tuple[bytes, bool, bool, float]) -> list[Outcome]:
    return tried(*task)


def main() -> int:
    parser = argparse.ArgumentParser(
        "tools/bench/mutated_scenes", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("kind", nargs="?", choices=("damaged", "odd"), default="damaged")
    parser.add_argument("--number", type=int, default=100_000)
    parser.add_argument("--from", type=int, default=0, dest="first", help="leaves so many files out")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--every-check", type=int, default=1, help="checks every so many-th, if it loads")
    parser.add_argument("--every-run", type=int, default=1, help="runs every so many-th, if it loads")
    parser.add_argument("--duration", type=float, default=1.0, help="of a run, s")
    parser.add_argument("--processes", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--json", type=Path, help="keep the counts")
    parser.add_argument("--keep", type=Path, metavar="DIR", help="keep the files with findings")
    arguments = parser.parse_args()
    counts: collections.Counter[str] = collections.Counter()
    findings: list[str] = []
    if arguments.keep:
        arguments.keep.mkdir(parents=True, exist_ok=True)
    last, seed = arguments.first + arguments.number, arguments.seed
    every = [*files(last, seed)] if arguments.kind == "damaged" else odd_files(seed)[:last]
    tasks = [
        (data, i % arguments.every_check == 0, i % arguments.every_run == 0, arguments.duration)
        for i, data in [*enumerate(every)][arguments.first :]
    ]
    with ProcessPoolExecutor(arguments.processes) as pool:
        for done, outcomes in enumerate(pool.map(_tried, tasks, chunksize=20), 1):
            counts.update(outcome.name for outcome in outcomes)
            found = [outcome.finding for outcome in outcomes if outcome.finding]
            findings += found
            if found and arguments.keep:
                (arguments.keep / f"{done}.yaml").write_bytes(tasks[done - 1][0])
                (arguments.keep / f"{done}.txt").write_text("\n\n".join(found), encoding="utf-8")
            if done % 100 == 0 or done == len(tasks):
                print(f"\r{done} of {len(tasks)}, {len(findings)} findings ", end="", file=sys.stderr, flush=True)
    print(file=sys.stderr)
    print("| what came of it | files |\n|---|---|")
    for name, count in sorted(counts.items()):
        print(f"| {name} | {count} |")
    print(f"\n{len(findings)} findings" + "".join(f"\n* {finding}" for finding in findings[:20]))
    if arguments.json:
        document = {"seed": arguments.seed, "files": len(tasks), "counts": dict(counts), "findings": findings}
        arguments.json.write_text(json.dumps(document, indent=1) + "\n", encoding="utf-8")
    return 1 if findings else 0


if __name__ == "__main__":
    sys.exit(main())
