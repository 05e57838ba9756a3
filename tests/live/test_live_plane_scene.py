"""A scene in the plane, served: outlines in the model, coordinates as parameters, what is felt where the hand is."""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from live_clients import Block, Client, Served

from hapsim import predict
from hapsim.live.access import address_of
from hapsim.live.messages import Predict
from hapsim.live.osc import OscView
from hapsim.live.osc_query import OscQueryView
from hapsim.live.predicted import predicted
from hapsim.live.server import Server
from hapsim.running.live_parameters import parameters_of
from hapsim.scene import load_scene, parse_scene

Serve = Callable[..., Served]

SCENE = """
version: 1
rate: 1000
space: 2
device: {clock: host, mass: 0.2, friction: 1.0, travel: [-0.1, 0.1]}
modules:
  hand: {type: device, channels: [1, 0]}
  post: {type: ground, position: [0.03, 0.0]}
  ball: {type: mass, mass: 0.1, position: [0.0, 0.05]}
  disc: {type: shape, between: [hand, post], form: {disc: 0.02}, stiffness: 2000, damping: 5}
  lane: {type: guide, between: [ball, post], through: [[0, 0], [0.05, 0.02]], stiffness: 100, damping: 1, reach: 0.01}
"""


def place(block: Block) -> list[float]:
    return [float(one) for one in block.rows[-1, 1:]]


def blocks_until(client: Client, holds: Callable[[list[float]], bool]) -> list[float]:
    """Places of the watched modules, once that holds."""
    for _ in range(3000):
        message = client.next()
        if isinstance(message, Block) and message.kind == 2 and holds(place(message)):
            return place(message)
    raise AssertionError("never")


def test_a_client_learns_outlines_and_coordinates_and_moves_them(serve: Serve) -> None:
    served = serve(SCENE)
    with served.client() as client:
        model = client.ask(type="get")
        assert model["space"] == 2
        assert [one["name"] for one in model["channels"]] == ["hand.y", "hand.x"]
        drawn = [one for one in model["drawn"] if "places" in one]
        outlines = {one["name"]: (one["kind"], one["of"], one["about"]) for one in drawn}
        assert outlines == {
            "disc": ("outside", "hand", "post"),
            "lane": ("guide", "ball", "post"),
            "": ("travel", "", ""),
        }
        np.testing.assert_allclose(np.hypot(*np.array(drawn[0]["places"]).T), 0.02)
        assert {"post.x", "ball.y"} < {one["name"] for one in model["modules"] if one["masses"] is None}
        names = ["post.x", "post.y", "ball.y", "hand.x", "hand.y"]
        assert client.ask(type="subscribe", modules=names)["type"] == "done"
        hand = {"mock.hand.stiffness": [200, 200], "mock.hand.damping": [5, 5], "mock.hand.position": [0.01, -0.04]}
        values = hand | {"post.x.position": 0.05, "post.y.position": -0.01}
        assert client.ask(type="set", values=values)["type"] == "done"
        found = blocks_until(client, lambda at: abs(at[3] + 0.04) < 1e-5 and abs(at[4] - 0.01) < 1e-5)
        assert found[:3] == pytest.approx([0.05, -0.01, 0.05])
        changed = client.ask(type="adopt", scene=SCENE.replace("{disc: 0.02}", "{box: [0.04, 0.04]}"))
        assert changed["type"] == "done"
        outlines = [one for one in client.ask(type="get")["drawn"] if "places" in one]
        assert len(outlines[0]["places"]) == 9


def test_osc_has_an_address_for_each_coordinate(serve: Serve) -> None:
    served = serve(SCENE)
    osc = OscView(served.hub, address_of("--osc-at", ":0", 0), (), served.warnings.append)
    server = Server([osc, query := OscQueryView(osc)], served.warnings.append)
    server.start()
    with contextlib.closing(server):
        node = query._node("/hapsim/post/y/position")
        assert node is not None
        assert (node["TYPE"], node["VALUE"], node["UNIT"]) == ("f", [0.0], ["m"])
        hand = query._node("/hapsim/mock/hand/position")
        assert hand is not None
        assert hand["TYPE"] == "ff"
        assert "/hapsim/post/position" not in osc.parameters()
        assert osc.parameters()["/hapsim/disc/stiffness"].value == 2000.0


@pytest.mark.parametrize("at", [(0.011, 0.0), (0.02, 0.017), (0.0, 0.0)])
def test_what_is_felt_is_predicted_where_the_hand_is(at: tuple[float, float]) -> None:
    scene = parse_scene(SCENE)
    found: dict[str, Any] = predicted(scene, parameters_of(scene, False), Predict(type="predict", at=[at[1], at[0]]))
    prediction = predict(scene, at=at, with_margins=False)
    names, felt = prediction.parts[0].names, prediction.parts[0].felt
    for one in found["felt"]:
        assert one["hand"] == "hand"
        x, y = np.cos(np.radians(one["angle_deg"])), np.sin(np.radians(one["angle_deg"]))
        n = np.array([{"hand.x": x, "hand.y": y}[name] for name in names])
        assert [one["k"], one["b"]] == pytest.approx([n @ felt.k @ n, n @ felt.b @ n], abs=1e-6)
    assert len(found["felt"]) == 2
    assert found["contacts"] == ("" if at == (0.0, 0.0) else "disc is touched")
    assert found["verdict"] == ("at the limit" if at == (0.0, 0.0) else "slides")  # nothing brakes the ball
    assert [one["module"] for one in found["slides"]] == ([] if at == (0.0, 0.0) else ["hand"])


def test_a_change_is_predicted_before_it_is_made_and_instability_elsewhere_is_reported() -> None:
    scene = load_scene("configs/disc.yaml")

    def ask(**values: float) -> dict[str, Any]:
        named = {name.replace("__", "."): value for name, value in values.items()}
        return predicted(scene, parameters_of(scene, False), Predict(type="predict", at=[0.0, 0.0], values=named))

    assert (ask()["stable"], ask()["states"]) == (True, "")
    shaken = ask(disc__damping=0.5)
    assert (shaken["stable"], shaken["verdict"]) == (False, "stable")
    assert "disc" in shaken["states"]
    near = ask(post__x__position=0.015)
    assert near["contacts"] == "disc is touched"
