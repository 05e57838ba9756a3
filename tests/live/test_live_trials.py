"""Trials from a WebSocket client: answers, events and the record have what it asks for, at the same samples."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from live_clients import Client, serving

from hapsim.recording.trace import load_trace
from tests.trial_runs import SAMPLES, columns_of, scene

TRIALS = 60


def begun(client: Client, events: list[dict[str, Any]], **trial: Any) -> dict[str, Any]:
    """Begins a trial as soon as the one before has settled."""
    while True:
        client.socket.send(json.dumps({"type": "trial", "id": trial["number"], **trial}))
        while (answer := json.loads(client.socket.recv(timeout=30))).get("id") is None:
            events.append(answer)
        if answer["type"] == "done" or "still begins" not in answer["reason"]:
            return answer


def test_a_client_runs_sixty_trials(tmp_path: Path) -> None:
    record, asked, codes, events = tmp_path / "run.trace", list[tuple[int, int]](), list[int](), list[Any]()
    # In real time: a loop in virtual time leaves a client little of the interpreter.
    with serving(scene("device"), record=record, transport="paced") as served, served.client() as client:
        for number in range(1, TRIALS + 1):
            codes.append(37 * number % 256)
            values, restart = {"touch.stiffness": 100.0 + number}, ["drifter"] if number % 10 == 0 else []
            answer = begun(client, events, number=number, values=values, restart=restart, code=codes[-1], over=0)
            asked.append((answer["sample"], number))
        last = {"trial": TRIALS, "phase": "begun"}
        while not any(one.get("values") == last for one in events):
            events.append(json.loads(client.socket.recv(timeout=30)))
    phases = [
        (one["sample"], one["values"]["trial"]) for one in events if one.get("values", {}).get("phase") == "begun"
    ]
    assert phases == asked
    sample, outputs = columns_of(record, "sample", "outputs")
    at = np.searchsorted(sample, [first for first, _ in asked])
    assert ((outputs[at] >> 8) & 255).tolist() == codes
    assert ((outputs[at - 1] >> 8) & 255).tolist() == [0, *codes[:-1]]
    assert load_trace(record).trials == tuple(asked)


def test_a_trial_has_its_answer_and_its_events() -> None:
    with serving(scene()) as served, served.client() as client:
        answer = client.ask(
            type="trial", number=7, values={"touch.stiffness": 150.0}, restart=["drifter"], code={"led": 1}
        )
        event = client.event("trial")
        assert (answer["type"], answer["sample"]) == ("done", event["sample"])
        assert event["values"] == {"trial": 7, "phase": "begun"}
        assert client.event("changed")["values"] == {"touch.stiffness": 150.0, "outputs.led": 1}
        settled = client.event("trial", phase="settled")
        assert (settled["values"]["phase"], settled["sample"]) == ("settled", answer["sample"] + SAMPLES - 1)


@pytest.mark.parametrize(
    ("trial", "why"),
    [
        ({"number": 1, "values": {"touch.stifness": 1.0}}, "stifness"),
        ({"number": 1, "values": {"touch.stiffness": -1.0}}, "touch.stiffness"),
        ({"number": 1, "restart": ["drifetr"]}, "did you mean 'drifter'"),
        ({"number": 1, "code": 256}, "outputs.code: found 256"),
        ({"number": 1, "code": {"led": 2}}, "outputs.led: found 2"),
    ],
)
def test_what_cannot_be_a_trial_is_rejected_with_the_reason(trial: dict[str, Any], why: str) -> None:
    with serving(scene()) as served, served.client() as client:
        assert why in client.ask(type="trial", **trial)["reason"]
        client.socket.send('{"type": "trial", "number": 0.5, "id": "x"}')
        assert "trial.number: found 0.5, expected a whole number" in client.message(type="rejected", id=None)["reason"]
        assert served.session.scene == scene()
