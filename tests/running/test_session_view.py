"""A program's view of a running scene: parameters, state, every sample, markers, records that start and stop."""

from __future__ import annotations

import threading
from pathlib import Path

import numpy as np
import pytest

import hapsim
from hapsim.errors import DeviceError, UsageError
from hapsim.recording.stream import open_record
from hapsim.running import Event
from hapsim.running.live_parameters import changes_from, parameters_of
from hapsim.scene import Scene, load_scene, parse_scene
from hapsim.scene.shipped import shipped_scenes

TICKS = 50_000  # more than the ring holds


@pytest.fixture
def scene() -> Scene:
    found = load_scene("configs/first_touch.yaml")
    device = found.device.model_copy(update={"clock": "lockstep"})
    return found.model_copy(update={"device": device})


class TestAStream:
    def test_it_has_every_sample_of_the_trace_in_si_units(self, scene: Scene) -> None:
        streams: list[hapsim.running.Stream] = []
        follow = {"on_arming": lambda session: streams.append(session.stream())}
        with hapsim.start(scene, duration=TICKS * scene.period, **follow) as session:
            pieces = list(streams[0])
        trace = session.trace
        assert len(pieces) > 1
        for name in ("sample", "time_ns", "flags", "position", "force"):
            assert np.array_equal(np.concatenate([getattr(one, name) for one in pieces]), getattr(trace, name)), name
        velocity = np.concatenate([one.velocity for one in pieces])
        assert np.allclose(velocity[1:], np.diff(trace.position, axis=0) * scene.rate, rtol=1e-9, atol=1e-12)
        assert velocity[0] == 0.0

    def test_across_lost_positions_the_velocity_is_that_of_the_time_between(self) -> None:
        rows = np.zeros(3, hapsim.recording.recorder.np.dtype([("sample", "i8"), ("time_ns", "i8"), ("flags", "u1"),
            ("position_counts", "i4", (1,)), ("force_counts", "i4", (1,))]))  # fmt: skip
        rows["sample"], rows["position_counts"][:, 0] = (4, 5, 9), (0, 2, 10)
        scales = hapsim.recording.recorder.Scales(1000.0, lambda _: np.array([0.5]))
        assert scales.samples(rows).velocity.tolist() == [[0.0], [1000.0], [1000.0]]
        rows["sample"], rows["position_counts"][:, 0] = (10, 11, 12), (14, 14, 16)
        assert scales.samples(rows).velocity.tolist() == [[2000.0], [0.0], [1000.0]]

    def test_one_that_is_read_too_late_reports_how_much_is_lost(self) -> None:
        scales = hapsim.recording.recorder.Scales(1000.0, lambda _: np.ones(1))
        stream = hapsim.running.Stream(scales, 10, lambda: False, lambda: None)
        for _ in range(3):
            stream.put(np.zeros(5, np.int8))
        with pytest.raises(UsageError, match="15 samples are lost"):
            stream.take()
        assert stream.take() is None

    def test_nothing_is_kept_for_one_that_nobody_has(self, scene: Scene) -> None:
        with hapsim.start(scene) as session:
            kept = session.stream()
            assert list(session._recorder._streams) == [kept]
            del kept
            assert list(session._recorder._streams) == []


class TestTheLatestValues:
    def test_they_are_those_of_the_last_sample(self, scene: Scene) -> None:
        with hapsim.start(scene, duration=0.05) as session:
            session.wait()
            state, at = session.state(), session.positions(["hand", "wall"])[1].tolist()
            shown = f"{session} {session._repr_html_()}"
        trace = session.trace
        assert state.sample == trace.sample[-1]
        assert state.position == tuple(trace.position[-1])
        assert trace.force[-1].any()
        assert state.force == (0.0,)  # released by now
        assert np.allclose(state.velocity, (trace.position[-1] - trace.position[-2]) * scene.rate)
        assert state.modules["hand"] == state.position[0]
        assert at == [state.position[0], 0.0]
        assert state.progress.phase == "ended"
        assert session.history().sample.tolist() == trace.sample.tolist()
        assert "touch.stiffness" in shown
        assert "ended" in shown

    def test_every_module_has_its_position(self) -> None:
        scene = load_scene("configs/plucked_string.yaml")
        scene = scene.model_copy(update={"device": scene.device.model_copy(update={"clock": "lockstep"})})
        with hapsim.start(scene, duration=0.02) as session:
            session.wait()
            modules = session.state().modules
        gut = scene.structures["gut"]
        assert set(modules) == {*scene.device_points, *scene.grounds, *scene.material_points, *scene.structures}
        assert modules["gut"].shape == (gut.masses,)
        assert np.abs(modules["gut"]).max() > 0.0

    def test_a_subscription_gives_them_until_the_run_ends(self, scene: Scene) -> None:
        with hapsim.start(scene, duration=60.0) as session:
            states = session.subscribe(1e6)
            first = next(states)
            session.stop()
            ages = [state.sample for state in states]
        assert ages == sorted(ages)
        assert first.progress.phase in ("running", "ended")
        with pytest.raises(UsageError, match="expected how often a second"):
            next(session.subscribe(0.0))


class TestParameters:
    @pytest.mark.thorough(keep=12)
    @pytest.mark.parametrize("name", shipped_scenes())
    def test_each_can_be_set_to_the_value_it_has(self, name: str) -> None:
        scene = load_scene(f"configs/{name}.yaml")
        scene = scene.with_others_held(scene.ports[0]) if scene.ports else scene
        parameters = parameters_of(scene, has_mock=False)
        assert all(one.description for one in parameters.values())
        scene = scene.model_copy(update={"device": scene.device.model_copy(update={"clock": "lockstep", "port": None})})
        with hapsim.start(scene, transport="mock", unstable=True) as session:
            of_run = {name for name in session.parameters if not name.startswith(("mock.", "outputs."))}
            assert of_run == set(parameters)
            same = changes_from({name: one.value for name, one in parameters.items()}, parameters)
            session.set(same)

    def test_they_have_units_bounds_and_a_span_for_a_slider(self, scene: Scene) -> None:
        stiffness = parameters_of(scene, has_mock=True)["touch.stiffness"]
        assert (stiffness.part, stiffness.key, stiffness.unit) == ("touch", "stiffness", "N/m")
        assert (stiffness.value, stiffness.least, stiffness.most) == (2000.0, 0.0, None)
        assert stiffness.is_logarithmic
        low, high = stiffness.span
        assert low * high == pytest.approx(2000.0**2)
        position = parameters_of(scene, has_mock=True)["wall.position"]
        assert not position.is_logarithmic
        assert position.span[0] < 0.0 < position.span[1]
        knob = parameters_of(load_scene("configs/knob_24.yaml"), has_mock=True)
        assert knob["detent.damping"].unit == "N·m·s/rad"
        assert knob["detent.shape"].words == ("sine", "snap", "notch")

    def test_an_unknown_name_gets_a_suggestion(self, scene: Scene) -> None:
        with pytest.raises(UsageError, match=r"found 'touch.stifness'.*did you mean 'touch.stiffness'"):
            changes_from({"touch.stifness": 1.0}, parameters_of(scene, has_mock=False))


class TestEventsAndRecords:
    def test_changes_markers_and_records_are_events(self, scene: Scene, tmp_path: Path) -> None:
        events: list[Event] = []
        path = tmp_path / "touch.trace"
        with hapsim.start(scene, on_event=events.append) as session:
            session.set({"touch": {"stiffness": 500.0}})
            session.mark("here")
            session.record(path)
            with pytest.raises(UsageError, match=r"touch\.trace is being recorded"):
                session.record(tmp_path / "other.trace")
            self.wait_for_rows(session)
            assert session.stop_recording() == path
            assert session.stop_recording() is None
            with pytest.raises(UsageError, match="the file exists"):
                session.record(path)
            assert [one.sentence for one in session.markers] == ["here"]
        assert [one.kind for one in events] == ["changed", "marker", "recording", "recorded"]
        assert events[0].values == {"touch.stiffness": 500.0}
        assert [one.sample for one in events] == sorted(one.sample for one in events)
        recorded = hapsim.load_trace(path)
        whole = session.trace
        begin = int(np.searchsorted(whole.sample, recorded.sample[0]))
        assert np.array_equal(recorded.position, whole.position[begin : begin + recorded.sample.size])
        assert recorded.report.ending == "running"

    def test_a_record_that_is_not_stopped_ends_with_the_run(self, scene: Scene, tmp_path: Path) -> None:
        path = tmp_path / "touch.trace"
        with hapsim.start(scene) as session:
            session.record(path)
            self.wait_for_rows(session)
        recorded = hapsim.load_trace(path)
        assert recorded.sample[-1] == session.trace.sample[-1]
        assert recorded.report.ending == "stopped"

    @staticmethod
    def wait_for_rows(session: hapsim.Session) -> None:
        rows = threading.Event()
        stream = session.stream()
        while not rows.is_set():
            if len(next(stream)) > 0:
                rows.set()


def test_a_scene_without_modules_of_its_own_has_parameters_of_its_mock_alone() -> None:
    scene = parse_scene("version: 1\nrate: 1000\ndevice: {mass: 0.1}\nmodules: {hand: {type: device, channel: 0}}")
    assert [one.key for one in parameters_of(scene, has_mock=True).values()] == [
        "force",
        "stiffness",
        "damping",
        "position",
    ]


KNOB = """
version: 1
rate: 1000
device: {mass: 1.0e-4, friction: 2.0e-4, clock: lockstep, delay: 1, motion: rotary, force_limit: 1}
mock: {initial: {velocity: 60}}
modules:
  hand: {type: device, channel: 0}
  wall: {type: ground}
  rests: {type: detent, between: [hand, wall], pitch: 15 deg, depth: 0.03, hold_until: 0.8}
"""


def test_a_change_after_a_device_has_failed_raises_the_failure() -> None:
    text = """
version: 1
rate: 1000
device: {clock: lockstep, mass: 0.2, friction: 1.0}
mock: {hand: {force: 2}, quantum: 1.0e-12}
modules:
  hand: {type: device, channel: 0}
  wall: {type: ground}
  brake: {type: damper, between: [hand, wall], damping: 1}
"""

    def change_after_the_end() -> None:
        with hapsim.start(parse_scene(text)) as session:
            session.wait()
            session.set({"brake.damping": 2.0})

    with pytest.raises(DeviceError, match="a position left the range of its counts") as found:
        change_after_the_end()
    assert "the run is over" in str(found.value.__context__)


def test_each_new_place_of_a_detent_is_an_event_and_a_note_with_its_sample(tmp_path: Path) -> None:
    events: list[Event] = []
    file = tmp_path / "knob.trace"
    with hapsim.start(parse_scene(KNOB), duration=0.3, on_event=events.append, record=file) as session:
        session.wait()
        place = session.state().places
    trace, pitch, at, expected = session.trace, np.deg2rad(15.0), 0, []
    for sample, x in zip(trace.sample.tolist(), trace.position[:, 0].tolist(), strict=True):
        before = at
        while abs(x - at * pitch) > 0.8 * pitch:
            at += 1 if x > at * pitch else -1
        expected += [(sample, at)] if at != before else []
    assert len(expected) > 10
    assert [(one.sample, one.values["rests.place"]) for one in events if one.kind == "place"] == expected
    assert place == {"rests": at}
    notes = [one for one in open_record(file).notes if "place" in one]
    assert [(one["sample"], one["place"]) for one in notes] == expected
    assert {one["name"] for one in notes} == {"rests"}


def test_an_event_may_come_while_the_first_position_is_read(scene: Scene) -> None:
    """Then the number of the newest sample is -1."""
    with hapsim.start(scene, duration=0.05) as session:
        session.wait()
        session._loop.state.sample = -1
        assert session.mark("early").sample == -1
