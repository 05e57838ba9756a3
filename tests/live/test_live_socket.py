"""The WebSocket of a running scene: requests, answers, events, blocks of samples. `Client` holds each message to the
schema."""

from __future__ import annotations

import gc
import json
import socket
import threading
import time
import weakref
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from live_clients import SCENE, SCHEMA, Served
from websockets.exceptions import ConnectionClosed

from hapsim.live import hub, server
from hapsim.live.messages import schema
from hapsim.recording.trace import load_trace

Serve = Callable[..., Served]

SLOW = SCENE.replace("rate: 1000", "rate: 50").replace("stiffness: 2000, damping: 5", "stiffness: 2, damping: 0.5")
STRUCTURES = (
    SCENE
    + """
  gut: {type: string, masses: 8, mass: 0.001, stiffness: 300, damping: 0.01, position: 0.001}
  skin: {type: membrane, rows: 3, columns: 4, mass: 0.001, stiffness: 150, damping: 0.01, position: 0.002}
"""
)


def test_the_schema_s_file_is_that_of_the_messages() -> None:
    assert schema() == SCHEMA, "run tools/messages"


def test_the_model_describes_what_there_is(serve: Serve) -> None:
    served = serve(STRUCTURES)
    with served.client() as client:
        model = client.ask(type="get")
    parameters = {one["name"]: one for one in model["parameters"]}
    assert parameters.keys() == served.session.parameters.keys()
    assert (parameters["touch.stiffness"]["value"], parameters["touch.stiffness"]["unit"]) == (2000.0, "N/m")
    assert model["channels"][0] == {
        "channel": 0, "name": "hand", "motion": "linear", "unit_position": "m", "unit_force": "N",
        "force_limit": 10.0, "travel": [None, None], "hand": {"stiffness": 200.0, "damping": 2.0, "reach": 0.02},
    }  # fmt: skip
    modules = [tuple(one.values()) for one in model["modules"]]
    assert modules == [("hand", None, None), ("wall", None, None), ("gut", 8, None), ("skin", 12, 4)]
    assert (model["phase"], model["has_mock"], model["can_record"], model["recording"]) == ("running", True, True, None)
    assert [one["kind"] for one in model["events"]] == ["armed"]


def test_no_answer_waits_for_the_acknowledgement_of_the_event_before_it(serve: Serve) -> None:
    served = serve()
    with served.client() as client:
        client.ask(type="get")
        (connection,) = served.view._server.connections
        of_client = connection.transport.get_extra_info("socket")
        assert of_client.getsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY)


def test_a_change_reaches_the_scene_and_everybody_receives_it(serve: Serve) -> None:
    served = serve()
    with served.client() as one, served.client() as other:
        other.ask(type="get")
        assert one.ask(type="set", values={"touch.stiffness": 1500, "touch.damping": 4}, over=0)["type"] == "done"
        assert other.event("changed")["values"] == {"touch.stiffness": 1500.0, "touch.damping": 4.0}
        found = one.ask(type="set", values={"touch.stiffnes": 1500})
        assert "did you mean" in found["reason"]
        assert other.event("rejected")["sentence"] == found["reason"]
        counted = one.ask(type="subscribe"), one.message(type="counters")
        assert (counted[1]["clients"], counted[1]["rejected"]) == (2, 1)
    touch: Any = served.session.scene.modules["touch"]
    assert (touch.stiffness, touch.damping) == (1500.0, 4.0)


def test_a_burst_of_changes_is_answered_one_by_one_and_ends_at_the_last(serve: Serve) -> None:
    served = serve()
    with served.client() as client:
        for number in range(400):
            client.send(type="set", values={"touch.stiffness": 1000 + number}, id=number, over=0)
        answers = [client.message(type="done")["id"] for _ in range(400)]
        assert answers == list(range(400))
        changed = [one["values"]["touch.stiffness"] for one in client.heard if one["type"] == "event"]
        while changed[-1] != 1399.0:
            changed.append(client.message(kind="changed")["values"]["touch.stiffness"])
    assert changed == sorted(changed)
    touch: Any = served.session.scene.modules["touch"]
    assert touch.stiffness == 1399.0


def test_blocks_have_every_sample_of_the_run(serve: Serve, tmp_path: Any) -> None:
    served = serve(record=tmp_path / "all.npz")
    with served.client() as client:
        client.ask(type="subscribe", rate=200, history=60)
        blocks = [client.block() for _ in range(20)]
        client.send(type="stop")  # `ask` would pass over the blocks before the answer
        blocks += client.blocks_to_the_end()
        assert client.closed == (1001, "the run has ended")
    served.session.wait()
    trace = load_trace(tmp_path / "all.npz")
    assert {(one.channels, one.period) for one in blocks} == {(1, 0.001)}
    rows = np.concatenate(
        [np.column_stack([one.first + one.rows[:, 0].astype(int), one.rows[:, 2:]]) for one in blocks]
    )
    assert np.array_equal(rows[:, 0], trace.sample)
    assert np.array_equal(rows[:, 1], trace.position[:, 0].astype("f4"))
    assert np.array_equal(rows[:, 3], trace.force[:, 0].astype("f4"))


def test_blocks_have_what_the_device_senses(serve: Serve) -> None:
    slow = SLOW.replace("device: {", "device: {sensors: [velocity, acceleration], ")
    with serve(slow).client() as client:
        assert client.ask(type="get")["sensed"] == ["velocity", "acceleration"]
        client.ask(type="subscribe", rate=100, history=60)
        blocks = [client.block().rows for _ in range(30)]
        rows = np.concatenate(blocks).astype(float)
    _, _, _, velocity, force, sensed, acceleration = rows[5:].T
    acted = (np.roll(force, 1) - sensed) / 0.2  # by the force that answers the sample before
    # A busy machine lets some samples last longer.
    assert np.median(np.abs(sensed - velocity)) < 0.005, "the difference of two positions is the mean between them"
    assert np.abs(acceleration).max() > 0.1
    assert np.median(np.abs(acceleration - acted)) < 1e-3


def test_a_pulse_begins_at_the_sample_that_its_answer_names(serve: Serve) -> None:
    with serve().client() as client:
        client.ask(type="subscribe", rate=100)
        answer = client.ask(type="pulse", channel=0, shape="click", force=0.5, seconds=5.0)
        event = client.event("pulse")
        assert answer["type"] == "done"
        assert event["sample"] == answer["sample"]
        assert event["values"]["force"] == 0.5
        assert "on which a pulse runs" in client.ask(type="pulse", shape="click", force=0.5, seconds=0.05)["reason"]
        assert "expected click, knock or buzz" in client.ask(type="pulse", shape="x", force=0.5, seconds=0.05)["reason"]


def test_thinned_blocks_have_every_nth_sample_and_rate_0_ends_them(serve: Serve) -> None:
    with serve().client() as client:
        client.ask(type="subscribe", rate=100, every=7)
        blocks = [client.block() for _ in range(10)]
        numbers = np.concatenate([one.first + one.rows[:, 0] for one in blocks])
        assert np.all(np.diff(numbers) == 7)
        for _ in range(5):  # at once: each replaces the one before
            client.send(type="subscribe", rate=100)
        client.ask(type="subscribe", rate=0)
        client.ask(type="marker", text="from now on")
        assert client.event("marker")["sentence"] == "from now on"
        with pytest.raises(TimeoutError):
            client.next(timeout=0.1)


def test_watched_modules_come_in_the_order_asked_for(serve: Serve) -> None:
    served = serve(STRUCTURES)
    with served.client() as client:
        assert "gut.0 to gut.7" in client.ask(type="subscribe", modules=["gut.8"])["reason"]
        assert "did you mean 'hand'" in client.ask(type="subscribe", modules=["hnd"])["reason"]
        client.ask(type="subscribe", modules=["hand", "skin.2.3", "wall", "gut.0"], rate=10)
        client.block(kind=2)
        found = client.block(kind=2)
    assert found.rows.shape[0] > 1, "more than one a block"
    assert found.rows.shape[1] == 5
    assert found.rows[0, 0] == 0
    assert np.all(np.diff(found.rows[:, 0]) > 0), "none twice"
    assert found.rows[0, 2:].tolist() == pytest.approx([0.002, 0.0, 0.001])
    assert found.first > 0


def test_a_record_begins_and_ends_on_request(serve: Serve) -> None:
    served = serve()
    with served.client() as client:
        file = client.ask(type="record", on=True)["file"]
        assert client.ask(type="get")["recording"] == file
        assert "is being recorded" in client.ask(type="record", on=True)["reason"]
        assert client.ask(type="record", on=False)["file"] == file
        assert client.ask(type="record", on=False)["file"] is None
    assert len(load_trace(file).sample) > 0


def test_a_scene_is_adopted_by_its_text_and_a_wrong_one_is_rejected(serve: Serve) -> None:
    served = serve()
    with served.client() as client:
        wrong = client.ask(type="adopt", scene=SCENE.replace("stiffness", "stifness"))
        assert "did you mean 'stiffness'" in wrong["reason"]
        assert client.ask(type="adopt", scene=SCENE + "  push: {type: mass, mass: 0.1}\n")["type"] == "done"
        assert client.event("changed")["values"] == {}
        assert "push" in [one["name"] for one in client.ask(type="get")["modules"]]
    assert served.session.scene.device.port is None


def chain(masses: int) -> str:
    links = (f"  m{i}: {{type: mass, mass: 0.1}}\n  l{i}: {{type: spring, between: [m{i}, wall], stiffness: 9}}\n"
             for i in range(masses))  # fmt: skip
    return f"{SCENE}\n{''.join(links)}"


def string(masses: int) -> str:
    return f"{SCENE}\n  gut: {{type: string, masses: {masses}, mass: 0.01, stiffness: 9}}\n"


@pytest.mark.parametrize("large", [chain(hub.MOST_ADOPTED // 2), string(hub.MOST_ADOPTED), string(100_000)])
def test_a_scene_that_takes_too_long_to_adopt_is_refused_before_any_work(
    serve: Serve, monkeypatch: pytest.MonkeyPatch, large: str
) -> None:
    served = serve()
    monkeypatch.setattr(served.session, "adopt", lambda *_: pytest.fail("was adopted"))
    with served.client() as client:
        reason = client.ask(type="adopt", scene=large)["reason"]
    assert f"expected at most {hub.MOST_ADOPTED}" in reason
    assert "hapsim run" in reason


def test_a_scene_as_large_as_the_one_that_runs_may_be_adopted(serve: Serve, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(hub, "MOST_ADOPTED", 5)
    served = serve(string(20))
    with served.client() as client:
        larger = client.ask(type="adopt", scene=string(21))["reason"]
        assert "found 25 modules" in larger
        assert "expected at most 24" in larger
        assert client.ask(type="adopt", scene=string(20).replace("2000", "1800"))["type"] == "done"


@pytest.mark.parametrize("size", [0, 100_000])
def test_a_stop_does_not_wait_for_a_scene_that_is_adopted_and_all_else_does(
    serve: Serve, monkeypatch: pytest.MonkeyPatch, size: int
) -> None:
    served, begun, may_end = serve(), threading.Event(), threading.Event()
    adopt, session, order = served.session.adopt, served.session, list[str]()

    def slowly(*scene: Any) -> None:
        begun.set()
        assert may_end.wait(60)
        adopt(*scene)
        order.append("adopted")

    monkeypatch.setattr(session, "adopt", slowly)
    monkeypatch.setattr(session, "mark", order.append)
    with served.client() as client:
        client.send(type="adopt", scene=SCENE.replace("2000", "1500") + "#" * size)
        client.send(type="marker", text="later")
        assert begun.wait(60)
        with served.client() as other:  # whose requests wait for nobody
            assert other.ask(type="marker", text="of another")["type"] == "done"
        may_end.set()
        assert client.ask(type="get")["type"] == "model"
        assert order == ["of another", "adopted", "later"]
        may_end.clear()
        client.send(type="adopt", scene=SCENE)
        client.send(type="stop")
        assert session.wait(60), "though the scene is not adopted yet"
        may_end.set()


def test_a_stop_does_not_wait_for_requests_that_wait_for_a_scene(serve: Serve, monkeypatch: pytest.MonkeyPatch) -> None:
    """As of a hand that is dragged meanwhile: more of them than the answers that may wait."""
    served, may_end = serve(), threading.Event()
    monkeypatch.setattr(served.session, "adopt", lambda *_: may_end.wait(60))
    with served.client() as client:
        with served.ending():
            client.send(type="adopt", scene=SCENE)
            for _ in range(500):
                client.send(type="set", values={"touch.stiffness": 1500.0})
            client.send(type="stop")
            assert served.session.wait(60), "though the scene is not adopted yet"
            may_end.set()
        client.blocks_to_the_end()  # with answers unread, closing waits for ten seconds


@pytest.mark.parametrize("is_away", [False, True])
def test_a_stop_ends_the_run_even_where_the_device_is_away(serve: Serve, is_away: bool) -> None:
    served = serve()
    if is_away:
        served.pause()
    with served.client() as client, served.ending():
        assert client.ask(type="stop")["type"] == "done"
        client.event("ended")


def test_a_client_ends_no_record_that_the_run_was_started_with(serve: Serve, tmp_path: Path) -> None:
    served = serve(record=tmp_path / "whole.trace")
    with served.client() as client:
        for on in (False, True):
            answer = client.ask(type="record", on=on)
            assert answer["type"] == "rejected"
            assert f"found the record {tmp_path / 'whole.trace'}, which hapsim was started with" in answer["reason"]
        assert client.ask(type="get")["recording"] == str(tmp_path / "whole.trace")
        with served.ending():
            client.ask(type="stop")
    assert load_trace(tmp_path / "whole.trace").sample.tolist() == list(range(served.session.trace.report.ticks))


def test_a_client_stays_while_the_device_is_away(serve: Serve) -> None:
    served = serve()
    with served.client() as client:
        client.ask(type="subscribe", rate=100, history=60)
        client.block()
        client.ask(type="set", values={"touch.stiffness": 1200})
        served.pause()
        assert client.ask(type="get")["phase"] == "waiting"
        assert "nothing runs" in client.ask(type="set", values={"touch.stiffness": 1500})["reason"]
        assert "nothing runs" in client.ask(type="marker")["reason"]
        assert "found a run that is waiting" in client.ask(type="go_on")["reason"]
        served.resume()
        client.event("armed")
        model = client.ask(type="get")
        assert {one["name"]: one["value"] for one in model["parameters"]}["touch.stiffness"] == 1200.0
        assert client.block().first < 1000


def test_a_run_that_the_machine_held_up_goes_on_when_a_client_asks(serve: Serve) -> None:
    served, asked = serve(), list[bool]()
    with served.client() as client:
        served.pause()
        served.hub.observer.paused(lambda: asked.append(True))
        served.hub.observer.report("paused", "held up")
        assert client.event("paused")["sentence"] == "held up"
        assert client.ask(type="get")["can_go_on"] is True
        assert client.ask(type="go_on")["type"] == "done"
        assert asked == [True]
        assert "found a run that is waiting" in client.ask(type="go_on")["reason"]
        assert client.ask(type="get")["can_go_on"] is False
        served.resume()


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "found no JSON"),
        ('{"type": "get"', "found no JSON"),
        ("[" * 60_000, "found no JSON"),
        (b"\0\1", "found a binary message"),
        ("[1]", "expected an object"),
        ("{}", "type: found null, expected one of get, set"),
        ('{"type": "sett"}', "did you mean 'set'"),
        ('{"type": "get", "values": {}}', 'found the key "values"'),
        ('{"type": "get", "id": [1]}', "get.id: found [1], expected a number"),
        ('{"type": "set"}', "set.values: found nothing"),
        ('{"type": "set", "values": {"touch.stiffness": true}}', "found true, expected an object of parameters"),
        ('{"type": "set", "values": {"touch.stiffness": NaN}}', 'found "NaN"'),
        ('{"type": "set", "values": {"touch.stiffness": 1e999}}', 'found "Infinity"'),
        ('{"type": "set", "values": {"touch.stiffness": -1}}', "touch.stiffness"),
        ('{"type": "set", "values": {"touch.damping": 1e308}}', "at most 1e+12 in size"),
        ('{"type": "set", "values": {"touch.stiffness": [1, 2]}}', "touch.stiffness"),
        ('{"type": "set", "values": {"touch.stiffness": "stiff"}}', "touch.stiffness"),
        ('{"type": "set", "values": {"touch.stiffness": 9}, "over": -1}', "set.over: found -1, expected seconds"),
        ('{"type": "set", "values": {"touch.mass": 1}}', "touch.mass"),
        ('{"type": "subscribe", "rate": 1e9}', "expected blocks a second, 0 to 1000"),
        ('{"type": "subscribe", "every": 0}', "subscribe.every: found 0"),
        ('{"type": "adopt", "scene": "/etc/passwd"}', "the scene that was sent"),
        ('{"type": "marker", "text": "' + "x" * 70_000 + '"}', "marker.text: found"),
        ('{"type": "set", "values": {"a": "' + " " * 190 + '"}' + " " * 70_000 + "}", "expected at most 65536"),
    ],
)
def test_a_wrong_message_is_answered_with_what_is_wrong(shared: Served, text: str | bytes, said: str) -> None:
    with shared.client() as client:
        client.socket.send(text)
        reason = client.message(type="rejected")["reason"]
        assert said in reason
        assert "defect" not in reason
        assert len(reason) < 1000
        assert client.ask(type="get")["type"] == "model"


def test_a_message_beyond_every_limit_closes_the_connection(shared: Served) -> None:
    with shared.client() as client:
        client.socket.send(json.dumps({"type": "adopt", "scene": "x" * (1 << 20)}))
        with pytest.raises(ConnectionClosed):
            client.next()
        assert client.closed[0] == 1009
    assert not shared.warnings


class _Circle:
    """Refers to itself: only a collector finds it."""

    def __init__(self) -> None:
        self.itself = self


def test_what_clients_leave_is_collected_where_the_collector_is_off(monkeypatch: pytest.MonkeyPatch) -> None:
    """So it is with real-time privileges: a run that is watched for days would grow with every client."""
    monkeypatch.setattr(server, "_COLLECT_S", 0.01)
    running = server.Server([], lambda _: None)
    gc.disable()
    gc.freeze()  # a collection then takes no second for what the other tests have left
    try:
        running.start()
        left = weakref.ref(_Circle())
        give_up = time.monotonic() + 60.0
        while left() is not None:
            assert time.monotonic() < give_up
            time.sleep(0.01)
    finally:
        gc.unfreeze()
        gc.enable()
        running.close()
