"""Streams of a run for Lab Streaming Layer, received by its own inlet: samples and events with the record's times."""

from __future__ import annotations

import sys
from types import ModuleType
from typing import Any

import numpy as np
import pytest

import hapsim
from hapsim.errors import UsageError
from hapsim.scene import Scene, parse_scene

NAME = "hapsim test"


@pytest.fixture
def scene() -> Scene:
    return parse_scene("""
version: 1
rate: 1000
device: {clock: lockstep, mass: 0.2, motion: [rotary, linear]}
mock: {initial: {velocity: [0.1, 0.2]}}
modules:
  knob: {type: device, channel: 0}
  hand: {type: device, channel: 1}
  wall: {type: ground}
  turn: {type: viscoelastic, between: [knob, wall], stiffness: 500, damping: 5}
  touch: {type: viscoelastic, between: [hand, wall], stiffness: 500, damping: 5}
""")


def test_samples_and_events_have_the_times_of_the_record(scene: Scene) -> None:
    try:
        import pylsl
    except (ImportError, RuntimeError) as error:
        pytest.skip(f"LSL is not installed here: {error}")
    with hapsim.start(scene, transport="paced", lsl=NAME) as session:
        found = [pylsl.resolve_byprop("name", name, timeout=5.0) for name in (NAME, f"{NAME} events")]
        if not all(found):
            pytest.skip("LSL finds no stream of this machine: its network lets no multicast through")
        samples, events = (pylsl.StreamInlet(one[0]) for one in found)
        for inlet in (samples, events):
            inlet.open_stream(5.0)
        marked = session.mark("here")
        session.set({"touch.stiffness": 400.0}, over=0.0)
        received, at = _pulled(samples, 200)
        texts, when = _pulled(events, 2)
    trace = session.trace
    rows = np.flatnonzero(np.isin(trace.time_ns, np.round(1e9 * np.array(at)).astype(np.int64)))
    assert rows.size == len(at), "each stamp is that of a row, to the nanosecond"
    assert np.array_equal(received, np.hstack([trace.position, trace.force])[rows])
    assert [one for (one,) in texts] == ["here", 'changed {"touch.stiffness": 400.0}']
    assert round(1e9 * when[0]) == trace.time_ns[trace.sample == marked.sample][0]
    channel, labels = samples.info().desc().child("channels").child("channel"), []
    while channel.child_value("label"):
        labels.append((channel.child_value("label"), channel.child_value("unit")))
        channel = channel.next_sibling()
    assert labels == [("position_0", "rad"), ("position_1", "m"), ("force_0", "N·m"), ("force_1", "N")]


def _pulled(inlet: Any, count: int) -> tuple[list[Any], list[float]]:
    pulled = [inlet.pull_sample(timeout=5.0) for _ in range(count)]
    assert all(value is not None for value, _ in pulled), "nothing came for 5 s"
    return [value for value, _ in pulled], [stamp for _, stamp in pulled]


def test_a_stream_that_fails_is_reported_once_and_the_run_goes_on(
    scene: Scene, monkeypatch: pytest.MonkeyPatch
) -> None:
    said: list[str] = []
    fake = _fake_lsl()
    monkeypatch.setitem(sys.modules, "pylsl", fake)
    with hapsim.start(scene, transport="paced", lsl=NAME, duration=0.3, on_warning=said.append) as session:
        session.wait()
    assert session.trace.report.ending == "done"
    assert said == ["LSL: from here on no samples are sent (the network is down)"]


def test_what_cannot_be_streamed_is_refused_before_the_device_is_opened(
    scene: Scene, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "pylsl", _fake_lsl())
    with pytest.raises(UsageError, match="found virtual time"):
        hapsim.start(scene, lsl=NAME)
    monkeypatch.setitem(sys.modules, "pylsl", None)
    with pytest.raises(UsageError, match=r"found no Python package pylsl, expected it: pip install 'hapsim\[lsl\]'"):
        hapsim.start(scene, transport="paced", lsl=NAME)


def _fake_lsl() -> ModuleType:
    class Anything:
        def __init__(self, *_: Any) -> None: ...

        def __getattr__(self, _: str) -> Any:
            return lambda *_: Anything()

    class Outlet(Anything):
        def push_chunk(self, *_: Any) -> None:
            raise OSError("the network is down")

    fake = ModuleType("pylsl")
    vars(fake).update(StreamInfo=Anything, StreamOutlet=Outlet, cf_double64=2, cf_string=3, local_clock=lambda: 5.0)
    return fake
