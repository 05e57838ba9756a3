"""A running scene, watched and changed: what `set` costs, how soon a change is felt, and what views cost the loop.

    tools/bench/panel [--only cost,latency,watched,frames,picture] [--seconds 10] [--rounds 5] [--streams osc]

* cost: µs that `Session.set` takes, by scene; each set has another value, in a loop that runs in real time.
* latency: from just before a change is sent to the arrival of the first position that is answered with it, at 1 kHz
  over a pseudo-terminal. The wall moves on by 1 µm a change; force and position of a row say where it was. From Python
  in the same process, over the WebSocket and over OSC of `hapsim run`, 50 and 1000 times per second; and from Pd and
  SuperCollider, which are sent each value, and set it, 50 and 200 times per second.
* watched: `hapsim run` with and without a panel (60 blocks per second), two streams of 1000 changes per second over OSC
  (or, `--streams websocket`, over that) and a client that subscribes and does not read, taking turns: deadline misses,
  exchange time and wake-up latency. Between the two a run beside which another `hapsim run` is watched in this way: so
  much is due to programs that need the processors, and not to the views.
* frames: the page of 16 channels at 4 kHz in Chromium, headless: time from one picture to the next, and what the page's
  own code takes of it, while the scope shows 2 s and 60 s.
* picture: `hapsim run --realtime` at 1 kHz of a string of 1000 masses and of a membrane of 32 by 32, alone, with a page
  in Chromium whose picture is hidden, and with its picture, taking turns: deadline misses, pictures drawn per second.
"""

from __future__ import annotations

import argparse
import asyncio
import contextlib
import json
import os
import re
import shutil
import signal
import socket
import statistics
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pythonosc.osc_message_builder import OscMessageBuilder
from websockets.asyncio.client import connect
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import connect as connect_here

import hapsim
from hapsim.running import Trace

CONFIGS = Path(__file__).resolve().parents[2] / "configs"
CHANGED = {
    "first_touch": "touch.stiffness",
    "wall": "stop.stiffness",
    "four_keys": "c-spring.stiffness",
    "plucked_string": "pick.stiffness",
    "bowed_string": "bow.stiffness",
    "struck_membrane": "stick.stiffness",
}
STIFFNESS, STEP = 200.0, 1e-6
HELD = f"""\
version: 1
rate: 1000
device: {{mass: 0.2, clock: device, friction: 1.0}}
mock: {{hand: {{stiffness: 500, damping: 5}}}}
modules:
  hand:  {{type: device, channel: 0}}
  wall:  {{type: ground}}
  other: {{type: ground}}
  touch: {{type: viscoelastic, between: [hand, wall], stiffness: {STIFFNESS}, damping: 0}}
  more:  {{type: viscoelastic, between: [hand, other], stiffness: 10, damping: 0.1}}
"""
Send = Callable[[float], object]


def paced(rate: float, seconds: float) -> Iterator[int]:
    """Numbers from 1 on, at this rate."""
    begin = time.monotonic()
    for i in range(1, round(rate * seconds) + 1):
        time.sleep(max(begin + i / rate - time.monotonic(), 0.0))
        yield i


def sent_at(send: Send, rate: float, seconds: float) -> NDArray[np.int64]:
    """Moves the wall on and on; returns when each change was begun, ns."""
    begun = []
    for i in paced(rate, seconds):
        begun.append(time.monotonic_ns())
        send(i * STEP)
    return np.array(begun)


def latencies(trace: Trace, begun: NDArray[np.int64]) -> NDArray[np.float64]:
    """ms from each change to the first position that was answered with it or a later one; infinite for none."""
    more = 10.0 * trace.position[:, 0] + 0.1 * np.diff(trace.position[:, 0], prepend=0.0) * trace.rate
    wall = (trace.asked_force[:, 0] + more) / STIFFNESS + trace.position[:, 0]
    rows = np.searchsorted(np.maximum.accumulate(wall), (np.arange(begun.size) + 0.5) * STEP)
    arrived = np.append(trace.time_ns.astype(float), np.inf)
    return np.asarray((arrived[rows] - begun) * 1e-6)


@contextlib.contextmanager
def served(directory: Path, *options: str, scene: str = HELD) -> Iterator[tuple[str, int, list[Any], int]]:
    """`hapsim run` of a scene: its WebSocket, its OSC port; its report, once it has ended; its process."""
    (directory / "held.yaml").write_text(scene, encoding="utf-8")
    with contextlib.closing(socket.socket(socket.AF_INET, socket.SOCK_DGRAM)) as free:
        free.bind(("127.0.0.1", 0))
        osc = free.getsockname()[1]
    command = [sys.executable, "-m", "hapsim", "run", str(directory / "held.yaml"), "--json"]
    command += ["--transport", "terminal", "--serve-at", "127.0.0.1:0", "--osc-at", f"127.0.0.1:{osc}", *options]
    report: list[Any] = []
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        assert process.stderr is not None
        found = next(found for line in process.stderr if (found := re.search(r"http://([^/\s\"]+)/", line)))
        listener = threading.Thread(target=process.stderr.read)
        listener.start()
        url = f"ws://{found[1]}/live"
        with connect_here(url, origin=origin_of(url)) as client:
            while json.loads(ask(client, {"type": "get"}))["phase"] != "running":
                time.sleep(0.05)
        try:
            yield url, osc, report, process.pid
        finally:
            process.send_signal(signal.SIGINT)
        assert process.stdout is not None
        report.append(json.loads(process.stdout.read()))
        listener.join()


def ask(client: Any, message: dict[str, Any]) -> str:
    """Returns the answer to a request."""
    client.send(json.dumps(message))
    while json.loads(answer := client.recv())["type"] in ("event", "counters"):
        pass
    return str(answer)


def origin_of(url: str) -> Any:
    """Returns the origin that a page of the same server sends."""
    return url.replace("ws:", "http:").removesuffix("/live")


def osc_message(address: str, *values: float) -> bytes:
    """One OSC message of floats."""
    builder = OscMessageBuilder(address)
    for value in values:
        builder.add_arg(value, "f")
    return builder.build().dgram


# What is measured


def cost() -> None:
    """Prints what `Session.set` takes."""
    print("| scene, changed | `set`, µs, p50 | p99 | with `unstable=False`, p50 | p99 |\n|---|---|---|---|---|")
    for name, key in CHANGED.items():
        cells, (part, _, field) = [f"{name}, {key}"], key.rpartition(".")
        for unstable in (None, False):
            with hapsim.start(CONFIGS / f"{name}.yaml", transport="mock", unstable=unstable) as session:
                value, took = session.parameters[key].value, []
                for i in range(301):
                    begin = time.perf_counter()
                    session.set({part: {field: value * (1.0 - 1e-4 * i)}})  # type: ignore[operator]
                    took.append(1e6 * (time.perf_counter() - begin))
                    time.sleep(0.002)
            cells += [f"{one:.0f}" for one in np.quantile(took[1:], (0.5, 0.99))]
        print(f"| {' | '.join(cells)} |", flush=True)


def latency(seconds: float) -> None:
    """Prints how soon a change is felt."""
    print("| from | changes per second | p50, ms | p99 | most | never felt |\n|---|---|---|---|---|---|")
    for way in (
        "Python",
        "WebSocket",
        "OSC",
        *(name for name, (command, _) in PROGRAMS.items() if shutil.which(command)),
    ):
        for rate in (50.0, 200.0 if way in PROGRAMS else 1000.0):
            with tempfile.TemporaryDirectory() as directory:
                trace, begun = run_changed(way, rate, seconds, Path(directory))
            took = latencies(trace, begun)
            cells = [f"{one:.2f}" for one in np.quantile(took, (0.5, 0.99, 1.0), method="higher")]
            print(f"| {way} | {rate:g} | {' | '.join(cells)} | {np.isinf(took).sum()} |", flush=True)


def run_changed(way: str, rate: float, seconds: float, directory: Path) -> tuple[Trace, NDArray[np.int64]]:
    """The trace of a run that was changed in this way, and when each change was begun."""
    if way == "Python":
        scene = hapsim.parse_scene(HELD, "held")
        with hapsim.start(scene, transport="terminal", unstable=False) as session:
            begun = sent_at(lambda x: session.set({"wall": {"position": x}}, over=0.0), rate, seconds)
            time.sleep(0.2)
        return session.trace, begun
    file = directory / "run.trace"
    with served(directory, "--realtime", "--record", str(file)) as (url, osc, *_):
        if way in PROGRAMS:
            with relaying(way, osc, directory) as send:
                begun = sent_at(send, rate, seconds)
        elif way == "OSC":
            with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as out:
                out.connect(("127.0.0.1", osc))
                begun = sent_at(lambda x: out.send(osc_message("/hapsim/wall/position", x, 0.0)), rate, seconds)
        else:
            with connect_here(url, origin=origin_of(url), max_queue=None) as client:
                moved = {"type": "set", "over": 0.0}
                begun = sent_at(
                    lambda x: client.send(json.dumps(moved | {"values": {"wall.position": x}})), rate, seconds
                )
        time.sleep(0.2)
    return hapsim.load_trace(file), begun


PD = """\
#N canvas 0 0 400 300 12;
#X obj 10 10 loadbang;
#X msg 10 40 connect 127.0.0.1 {osc};
#X obj 150 10 netreceive -u -b {own};
#X obj 150 40 oscparse;
#X obj 150 70 list trim;
#X obj 150 100 route moved;
#X msg 150 130 \\$1 0;
#X obj 150 160 oscformat hapsim wall position;
#X obj 150 190 list prepend send;
#X obj 150 220 list trim;
#X obj 10 250 netsend -u -b;
#X connect 0 0 1 0;
#X connect 1 0 10 0;
"""
SCLANG = """\
~to = NetAddr("127.0.0.1", {osc});
thisProcess.openUDPPort({own});
OSCdef(\\moved, {{ |message| ~to.sendMsg('/hapsim/wall/position', message[1], 0.0) }}, '/moved');
"""
PROGRAMS = {"Pd": ("pd", PD), "SuperCollider": ("sclang", SCLANG)}


@contextlib.contextmanager
def relaying(way: str, osc: int, directory: Path) -> Iterator[Callable[[float], object]]:
    """A program that sets what it is sent; gives what sends it."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
        free.bind(("127.0.0.1", 0))
        own = free.getsockname()[1]
    command, text = PROGRAMS[way]
    file = directory / f"relay.{'pd' if way == 'Pd' else 'scd'}"
    chain = "".join(f"#X connect {i} 0 {i + 1} 0;\n" for i in range(2, 10)) if way == "Pd" else ""
    file.write_text(text.format(osc=osc, own=own) + chain, "utf-8")
    options = ["-nogui", "-noaudio", "-open", str(file)] if way == "Pd" else [str(file)]
    environment = os.environ | {"QTWEBENGINE_DISABLE_SANDBOX": "1", "QT_QPA_PLATFORM": "offscreen"}
    quiet = {"stdin": subprocess.PIPE, "stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    with (
        subprocess.Popen([command, *options], env=environment, **quiet) as process,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as out,
    ):
        time.sleep(10.0)  # until it listens
        try:
            yield lambda x: out.sendto(osc_message("/moved", x), ("127.0.0.1", own))
        finally:
            process.kill()


def watched(seconds: float, rounds: int, streams: str) -> None:
    """Prints what views cost the loop."""
    found: dict[str, list[dict[str, float]]] = {"alone": [], "beside": [], "watched": []}
    for number, how in enumerate([*found] * rounds):
        with contextlib.ExitStack() as stack:
            directory = Path(stack.enter_context(tempfile.TemporaryDirectory()))
            url, osc, report, _ = stack.enter_context(served(directory, "--realtime"))
            if how == "beside":
                url, osc, *_ = stack.enter_context(served(directory))
            if how == "alone":
                time.sleep(seconds)
            else:
                clients = [gently(stream, osc if streams == "osc" else url, one, seconds) for one in ("wall", "other")]
                for one in (*clients, gently(lambda to: asyncio.run(view(to, seconds)), url)):
                    one.join()
        ended = report[0]
        if ended["ending"] not in ("interrupted", "stopped"):
            print(f"run {number + 1}, {how}: {ended['ending']}", file=sys.stderr)
        found[how].append(
            {"deadline misses": ended["deadline_misses"] / ended["ticks"] * 1e6, "changes": ended["parameter_changes"]}
            | {f"exchange, µs, {q}": 1e6 * ended["exchange_s"][q] for q in ("p50", "p99")}
            | {f"wake-up latency, µs, {q}": 1e6 * ended["lateness_s"][q] for q in ("p50", "p99")}
        )
    print("| | alone | another run is watched | watched | watched / other watched |\n|---|---|---|---|---|")
    for what in found["alone"][0]:
        values = [[one[what] for one in of_kind] for of_kind in found.values()]
        ratios = [one / other for one, other in zip(values[2], values[1], strict=True) if other]
        cells = [*map(spread, values), spread(ratios, 2) if ratios else ""]
        print(f"| {what}{', per million' if what == 'deadline misses' else ''} | {' | '.join(cells)} |", flush=True)


def frames(seconds: float) -> None:
    """Prints how often the page draws."""
    with contextlib.ExitStack() as stack:
        directory = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        url, *_ = stack.enter_context(served(directory, scene=_many_channels()))
        page = stack.enter_context(_chromium())
        page.set_script_timeout(10 * seconds + 60)
        page.get(origin_of(url))
        print("| scope | picture to picture, ms, p50 | p99 | own code, ms, p50 | p99 | samples |")
        print("|---|---|---|---|---|---|")
        for span in (2, 60):
            found = page.execute_async_script(_COUNT_FRAMES, span, 1000 * seconds)
            cells = [f"{np.quantile(found[what], share):.1f}" for what in ("apart", "own") for share in (0.5, 0.99)]
            print(f"| {span} s | {' | '.join(cells)} | {found['samples']} |", flush=True)


def _chromium() -> Any:
    """Returns Chromium, headless."""
    from selenium import webdriver

    options = webdriver.ChromeOptions()
    for one in ("--headless=new", "--no-sandbox", "--disable-dev-shm-usage", "--window-size=1280,1000"):
        options.add_argument(one)
    return webdriver.Chrome(options, webdriver.ChromeService("/usr/bin/chromedriver"))


STRUCTURES = {
    "string of 1000": "{type: string, masses: 1000, mass: 0.0001, stiffness: 60, damping: 0.002, friction: 1.0e-4}",
    "membrane of 32 x 32": "{type: membrane, rows: 32, columns: 32, mass: 0.0001, stiffness: 40, damping: 0.002}",
}


def picture(seconds: float, rounds: int) -> None:
    """Prints what the moving picture of a thousand masses costs the loop, and how often it is drawn."""
    print("| scene | misses per million alone | page, no picture | its picture | ratio | pictures per second |")
    print("|---|---|---|---|---|---|")
    with _chromium() as page:
        page.set_script_timeout(10 * seconds + 60)
        for name, structure in STRUCTURES.items():
            end = "body.500" if "string" in name else "body.16.16"
            grip = f"  body: {structure}\n  grip: {{type: spring, between: [hand, {end}], stiffness: 20}}\n"
            found: list[list[tuple[float, float]]] = [[], [], []]
            for how in list(range(3)) * rounds:
                try:
                    found[how].append(_with_page(page, HELD + grip, seconds, how))
                except (ConnectionClosed, OSError, StopIteration) as error:
                    print(f"{name}, {how}: the run ended: {error!r}", file=sys.stderr)
            misses = [[1e6 * missed for missed, _ in each] for each in found]
            if all(found):
                ratio = (statistics.mean(misses[2]) + 1.0) / (statistics.mean(misses[1]) + 1.0)
                cells = [*map(spread, misses), f"{ratio:.2f}", spread([rate for _, rate in found[2]])]
                print(f"| {name} | {' | '.join(cells)} |", flush=True)


def _with_page(page: Any, scene: str, seconds: float, how: int) -> tuple[float, float]:
    """Share of deadline misses, and pictures per second, while the hand moves. `how`: 0 no page, 1 a page without its
    picture, 2 with it."""
    drawn = 0.0
    with tempfile.TemporaryDirectory() as directory, served(Path(directory), "--realtime", scene=scene) as (url, *_):
        if how:
            page.get(origin_of(url))
            page.execute_async_script(_SHOW_PICTURE, how == 2)
        moving = gently(to_and_fro, url, seconds)
        before = _progress(url)
        if how:
            drawn = page.execute_async_script(_COUNT_PICTURES, 1000 * seconds) / seconds
        moving.join()
        after = _progress(url)
        page.get("about:blank")
    missed, ticks = (after[name] - before[name] for name in ("deadline_misses", "ticks"))
    return missed / ticks, drawn


def _progress(url: str) -> dict[str, Any]:
    """The counters of a run."""
    with connect_here(url, origin=origin_of(url), max_queue=None) as client:
        client.send(json.dumps({"type": "subscribe", "rate": 1}))
        for message in client:
            if isinstance(message, str) and (found := json.loads(message))["type"] == "counters":
                return dict(found["progress"])
    raise ConnectionError("the run has ended")


def to_and_fro(url: str, seconds: float) -> None:
    """Moves the hand that holds the mock."""
    with connect_here(url, origin=origin_of(url), max_queue=None) as client:
        for i in paced(25.0, seconds):
            values = {"mock.hand.position": 0.01 * float(np.sin(0.3 * i))}
            client.send(json.dumps({"type": "set", "values": values, "over": 0.04}))


_SHOW_PICTURE = """
const [isShown, done] = arguments;
import("/panel.js").then(({picture, connection}) => {
  const wait = async () => {
    if (!picture.row) return setTimeout(wait, 50); // until the page is complete
    document.getElementById("picture-part").hidden = !isShown;
    await connection.ask({type: "subscribe", rate: 60, picture: isShown});
    done();
  };
  wait();
});
"""
_COUNT_PICTURES = """
const [length, done] = arguments;
import("/panel.js").then(({picture}) => {
  let count = 0, before = picture.row;
  const end = performance.now() + length, look = (now) => {
    count += picture.row !== before; // drawn in the frame of this call, or in the next one
    before = picture.row;
    now < end ? requestAnimationFrame(look) : done(count);
  };
  requestAnimationFrame(look);
});
"""

_COUNT_FRAMES = """
const [span, length, done] = arguments, apart = [], own = [], ask = window.requestAnimationFrame.bind(window);
import("/panel.js").then(({scope, samples}) => {
  scope.spanS = span;
  window.requestAnimationFrame = (draw) => ask((at) => {
    const begun = performance.now();
    draw(at);
    own.push(performance.now() - begun);
  });
  let before = performance.now(), end = before + length;
  const look = (now) => {
    apart.push(now - before);
    before = now;
    if (now < end) ask(look);
    else { window.requestAnimationFrame = ask; done({apart: apart.slice(2), own, samples: samples.count}); }
  };
  ask(look);
});
"""


def _many_channels() -> str:
    links = "".join(
        f"  hand{c}: {{type: device, channel: {c}}}\n"
        f"  touch{c}: {{type: viscoelastic, between: [hand{c}, wall], stiffness: 500, damping: 2}}\n"
        for c in range(16)
    )
    device = "device: {mass: 0.2, clock: device, friction: 1.0}\nmock: {hand: {stiffness: 100, damping: 1}}\n"
    return f"version: 1\nrate: 4000\n{device}modules:\n  wall: {{type: ground}}\n{links}"


def gently(work: Callable[..., None], *arguments: Any) -> threading.Thread:
    """Does this in a thread of low priority, as if on another machine; ends with the run where that ends early."""

    def run() -> None:
        os.setpriority(os.PRIO_PROCESS, threading.get_native_id(), 19)
        with contextlib.suppress(ConnectionClosed):
            work(*arguments)

    thread = threading.Thread(target=run)
    thread.start()
    return thread


def stream(at: int | str, name: str, seconds: float) -> None:
    """A stream that moves a ground to and fro, to an OSC port or a WebSocket."""
    with contextlib.ExitStack() as stack:
        if isinstance(at, int):
            out = stack.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM))
        else:
            client = stack.enter_context(connect_here(at, origin=origin_of(at), max_queue=None))
        for i in paced(1000.0, seconds):
            x = 1e-3 * float(np.sin(0.01 * i))
            if isinstance(at, int):
                out.sendto(osc_message(f"/hapsim/{name}/position", x, 0.005), ("127.0.0.1", at))
            else:
                client.send(json.dumps({"type": "set", "values": {f"{name}.position": x}, "over": 0.005}))


async def view(url: str, seconds: float) -> None:
    """A panel, and a client that does not read what it subscribed to."""
    origin = origin_of(url)
    wanted = json.dumps({"type": "subscribe", "rate": 60, "history": 60, "modules": ["hand"]})

    async def panel() -> None:
        async with connect(url, origin=origin) as client:
            await client.send(wanted)
            async for _ in client:
                pass

    async def slow() -> None:
        while True:
            with contextlib.suppress(ConnectionClosed, OSError):
                async with connect(url, origin=origin, max_queue=1) as client:
                    await client.send(wanted.replace("60", "1000", 1))
                    await client.wait_closed()

    with contextlib.suppress(TimeoutError):
        async with asyncio.timeout(seconds):
            await asyncio.gather(panel(), slow())


def spread(values: list[float], digits: int = 0) -> str:
    """Median, and the range in brackets."""
    form = f".{digits}f" if digits else ".3g"
    return f"{statistics.median(values):{form}} [{min(values):{form}}, {max(values):{form}}]"


def main() -> None:
    parser = argparse.ArgumentParser(
        "tools/bench/panel", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--only", default="cost,latency,watched")
    parser.add_argument("--seconds", type=float, default=10.0)
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--streams", choices=("osc", "websocket"), default="osc")
    arguments = parser.parse_args()
    for name in arguments.only.split(","):
        {
            "cost": cost,
            "latency": lambda: latency(arguments.seconds),
            "watched": lambda: watched(arguments.seconds, arguments.rounds, arguments.streams),
            "frames": lambda: frames(arguments.seconds),
            "picture": lambda: picture(arguments.seconds, arguments.rounds),
        }[name]()
        print()


if __name__ == "__main__":
    main()
