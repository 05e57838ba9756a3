"""The WebSocket of a running scene: requests, answers, events, blocks of samples."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np


def test_a_client_sees_the_model_and_changes_it(serve: Callable[..., Any]) -> None:
    served = serve()
    with served.client() as client:
        model = client.ask(type="get")
        assert [one["name"] for one in model["channels"]] == ["hand"]
        by_name = {one["name"]: one for one in model["parameters"]}
        assert by_name["touch.stiffness"]["value"] == 2000.0
        assert client.ask(type="set", values={"touch.stiffness": 1500})["type"] == "done"
        assert client.message(type="event")["values"] == {"touch.stiffness": 1500.0}
        assert served.session.scene.modules["touch"].stiffness == 1500.0


def test_blocks_have_every_sample(serve: Callable[..., Any]) -> None:
    served = serve()
    with served.client() as client:
        client.send(type="subscribe", rate=100, history=60)
        blocks = [client.block() for _ in range(10)]
    numbers = np.concatenate([one.first + one.rows[:, 0] for one in blocks])
    assert numbers.size > 1
    assert np.all(np.diff(numbers) == 1)
    assert blocks[0].rows.shape[1] == 2 + 3
