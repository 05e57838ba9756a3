"""OSCQuery over TCP, as its proposal describes it: what addresses there are, their values, and changes of them."""

from __future__ import annotations

import contextlib
import http.client
import json
import socket
from collections.abc import Callable, Iterator
from typing import Any

import pytest
from live_clients import SCENE, Served, serving
from pythonosc.osc_message import OscMessage
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import connect

from hapsim.live.access import address_of
from hapsim.live.osc import OscView
from hapsim.live.osc_query import OscQueryView
from hapsim.live.server import Server


class Asked:
    """A scene that answers OSC and OSCQuery."""

    def __init__(self, served: Served, senders: tuple[str, ...] = ()) -> None:
        self.served = served
        self.osc = OscView(served.hub, address_of("--osc-at", ":0", 0), senders, served.warnings.append)
        self.server = Server([self.osc, OscQueryView(self.osc)], served.warnings.append)
        self.server.start()
        self.port = self.osc.address.port

    def get(self, path: str, **headers: str) -> tuple[int, Any]:
        connection = http.client.HTTPConnection("127.0.0.1", self.port, timeout=10)
        connection.request("GET", path, headers=headers)
        answer = connection.getresponse()
        body = answer.read().decode()
        return answer.status, json.loads(body) if "json" in answer.headers["Content-Type"] else body

    @contextlib.contextmanager
    def listen(self, *paths: str, **options: Any) -> Iterator[Any]:
        with connect(f"ws://127.0.0.1:{self.port}/", compression=None, **options) as client:
            for path in paths:
                client.send(json.dumps({"COMMAND": "LISTEN", "DATA": path}))
            yield client


@pytest.fixture(scope="module")
def asked() -> Iterator[Asked]:
    with serving(SCENE.replace("damping: 5", "damping: {value: 5, range: [0, 0.02 N·s/mm]}")) as served:
        found = Asked(served)
        try:
            yield found
        finally:
            found.server.close()


def drain(client: Any) -> None:
    """Reads what is there already; TimeoutError where no more comes."""
    for _ in range(200):
        client.recv(timeout=0.3)


def received(client: Any, path: str, holds: Callable[[list[Any]], bool]) -> list[Any]:
    """The values of the first message from this path of which that holds."""
    while True:
        message = OscMessage(client.recv(timeout=20))
        if message.address == path and holds(message.params):
            return list(message.params)


def test_a_parameter_has_type_value_range_unit_and_access(asked: Asked) -> None:
    status, node = asked.get("/hapsim/touch/stiffness")
    assert status == 200
    assert node["FULL_PATH"] == "/hapsim/touch/stiffness"
    assert (node["TYPE"], node["VALUE"], node["UNIT"], node["ACCESS"]) == ("f", [2000.0], ["N/m"], 3)
    assert node["RANGE"] == [{"MIN": 0.0}]
    assert "tiffness" in node["DESCRIPTION"]
    for attribute in ("VALUE", "TYPE", "RANGE", "UNIT", "ACCESS", "DESCRIPTION", "FULL_PATH"):
        assert asked.get(f"/hapsim/touch/stiffness?{attribute}") == (200, {attribute: node[attribute]})


def test_the_range_of_the_scenes_file_has_both_ends_in_si_units(asked: Asked) -> None:
    _, node = asked.get("/hapsim/touch/damping")
    assert (node["RANGE"], node["UNIT"]) == ([{"MIN": 0.0, "MAX": 20.0}], ["N·s/m"])


def test_the_tree_has_every_address_once(asked: Asked) -> None:
    _, root = asked.get("/")
    paths = []

    def walk(node: dict[str, Any]) -> None:
        for name, inner in node.get("CONTENTS", {}).items():
            assert inner["FULL_PATH"].endswith(f"/{name}")
            walk(inner)
        if "TYPE" in node:
            paths.append(node["FULL_PATH"])

    walk(root)
    streamed = {f"/hapsim/{one}" for one in ("position", "velocity", "force", "ticks")}
    numbers = {name for name, one in asked.served.session.parameters.items() if one.kind != "points"}
    assert sorted(paths) == sorted(streamed | {f"/hapsim/{name.replace('.', '/')}" for name in numbers})
    assert asked.get("/hapsim/force")[1]["ACCESS"] == 1, "what is measured is only read"
    assert asked.get("/hapsim/touch?TYPE") == (204, ""), "a container has no type"


def test_the_host_states_where_osc_and_its_websocket_are(asked: Asked) -> None:
    info = asked.get("/?HOST_INFO")[1]
    assert (info["OSC_PORT"], info["WS_PORT"], info["OSC_TRANSPORT"]) == (asked.port, asked.port, "UDP")
    assert info["EXTENSIONS"]["LISTEN"] is True


@pytest.mark.parametrize(
    ("path", "status"),
    [("/hapsim/tuch", 404), ("/hapsim/touch/stiffness?LOUDNESS", 400), ("/hapsim/touch/stiffness/more", 404)],
)
def test_what_is_not_there_is_an_error(asked: Asked, path: str, status: int) -> None:
    assert asked.get(path)[0] == status


def test_a_listener_gets_what_changes_until_it_ignores_it(asked: Asked) -> None:
    path = "/hapsim/touch/damping"
    with asked.listen(path, "/hapsim/ticks") as client:
        assert received(client, path, bool) == [5.0]
        asked.served.session.set({"touch": {"damping": 3.5}})
        assert received(client, path, lambda values: values != [5.0]) == [3.5]
        first = received(client, "/hapsim/ticks", bool)
        assert received(client, "/hapsim/ticks", bool) > first, "and what the device measures, as it goes on"
        client.send(json.dumps({"COMMAND": "IGNORE", "DATA": "/hapsim/ticks"}))
        client.send(json.dumps({"COMMAND": "LISTEN", "DATA": "/hapsim/wall/position"}))
        received(client, "/hapsim/wall/position", lambda values: values == [0.0])
        with pytest.raises(TimeoutError):
            drain(client)


def test_it_only_reads(asked: Asked) -> None:
    before = asked.served.session.scene
    with asked.listen() as client:
        client.send(b"/hapsim/touch/stiffness\0,f\0\0\0\0\0\0")
        with pytest.raises(ConnectionClosed, match="values are set by OSC over UDP"):
            client.recv(timeout=10)
    for method in ("PUT", "POST"):
        connection = http.client.HTTPConnection("127.0.0.1", asked.port, timeout=10)
        connection.request(method, "/hapsim/touch/stiffness?VALUE", body="1")
        with contextlib.suppress(http.client.HTTPException, ConnectionError):  # it may just hang up
            assert connection.getresponse().status >= 400
    assert asked.served.session.scene == before


@pytest.mark.parametrize("text", ["", "[", "[]", "{}", '{"COMMAND": "SET", "DATA": 1}', '{"COMMAND": 1}', "[" * 4000])
def test_what_is_no_command_is_ignored(asked: Asked, text: str) -> None:
    with asked.listen() as client:
        client.send(text)
        client.send(json.dumps({"COMMAND": "LISTEN", "DATA": "/hapsim/wall/position"}))
        assert received(client, "/hapsim/wall/position", bool) == [0.0]


def test_a_longer_message_ends_the_connection(asked: Asked) -> None:
    with asked.listen() as client:
        client.send(" " * 5000)
        with pytest.raises(ConnectionClosed):
            client.recv(timeout=10)


def test_pages_from_elsewhere_are_refused_and_programs_without_an_origin_are_not(asked: Asked) -> None:
    assert asked.get("/?HOST_INFO", Origin="http://evil.example")[0] == 403
    assert asked.get("/?HOST_INFO", Host="evil.example")[0] == 403
    assert asked.get("/?HOST_INFO")[0] == 200
    with pytest.raises(InvalidStatus, match="403"), asked.listen(origin="http://evil.example"):
        pass


def test_a_client_too_many_is_sent_away_and_half_open_ones_do_no_harm(asked: Asked) -> None:
    half_open = [socket.create_connection(("127.0.0.1", asked.port)) for _ in range(20)]
    with contextlib.ExitStack() as stack:
        for _ in range(16):
            stack.enter_context(asked.listen())
        with asked.listen() as client, pytest.raises(ConnectionClosed, match="16 clients"):
            client.recv(timeout=10)
    for one in half_open:
        one.close()
    assert asked.get("/?HOST_INFO")[0] == 200


def test_only_listed_senders_are_answered() -> None:
    with serving(SCENE) as served:
        asked = Asked(served, senders=("192.0.2.7",))
        status, why = asked.get("/?HOST_INFO")
        asked.server.close()
    assert (status, why) == (403, "expected an address that --osc-from lists")


def test_a_client_stays_while_the_device_is_away() -> None:
    with serving(SCENE) as served:
        asked = Asked(served)
        with asked.listen("/hapsim/ticks", "/hapsim/touch/stiffness") as client:
            received(client, "/hapsim/ticks", bool)
            served.pause()
            status, why = asked.get("/hapsim/position")
            assert (status, "not armed yet" in why) == (404, True), "nothing is measured"
            assert asked.get("/hapsim/touch/stiffness?VALUE") == (200, {"VALUE": [2000.0]})
            served.resume()
            received(client, "/hapsim/ticks", lambda values: values[0] < 1000)
        asked.server.close()
