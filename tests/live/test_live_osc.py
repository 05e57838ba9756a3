"""OSC of a running scene. Packets are built and read by python-osc's own classes."""

from __future__ import annotations

import contextlib
import random
import socket
import struct
import time
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from typing import Any

import pytest
from live_clients import SCENE
from pythonosc.osc_bundle_builder import OscBundleBuilder
from pythonosc.osc_message import OscMessage
from pythonosc.osc_message_builder import OscMessageBuilder
from pythonosc.osc_packet import OscPacket

from hapsim.errors import UsageError
from hapsim.live.access import address_of
from hapsim.live.hub import Hub
from hapsim.live.osc import OscView
from hapsim.live.server import Server
from hapsim.running.live_parameters import Parameter
from hapsim.scene import parse_scene
from tests import thorough

PACKETS = thorough.points(700, 2000)
BATCH = 50  # that fit in a socket's buffer
# Slow enough for a busy machine: the watchdog of 100 samples lasts half a second.
SLOW = SCENE.replace("rate: 1000", "rate: 200").replace("stiffness: 2000, damping: 5", "stiffness: 200, damping: 2")

SOCKETS: list[socket.socket] = []  # of the test


@pytest.fixture(autouse=True)
def _closed() -> Iterator[None]:
    yield
    while SOCKETS:
        SOCKETS.pop().close()


def message(address: str, *arguments: Any) -> Any:
    builder = OscMessageBuilder(address)
    for one in arguments:
        builder.add_arg(one)
    return builder.build()


def bundle(due: float, *messages: Any) -> bytes:
    """`due`: Unix time in s; 0 for now."""
    builder = OscBundleBuilder(due)  # type: ignore[arg-type]
    for one in messages:
        builder.add_content(one)
    return bytes(builder.build().dgram)


class Client:
    """A program that speaks OSC to a view."""

    def __init__(self, view: OscView, ip: str = "127.0.0.1") -> None:
        self.socket = socket.socket(socket.AF_INET6 if ":" in ip else socket.AF_INET, socket.SOCK_DGRAM)
        SOCKETS.append(self.socket)
        self.socket.bind((ip, 0))
        self.socket.settimeout(30)
        self.port = self.socket.getsockname()[1]
        self._to = (view.address.ip, view.address.port)
        self._received: list[tuple[str, list[Any]]] = []

    def send(self, packet: bytes) -> None:
        self.socket.sendto(packet, self._to)

    def send_message(self, address: str, *arguments: Any) -> None:
        self.send(message(address, *arguments).dgram)

    def receive(self, *addresses: str) -> list[Any]:
        """The arguments of the next message of one of these addresses."""
        while True:
            while not self._received:
                packet = OscPacket(self.socket.recv(65536))
                self._received += [(one.message.address, list(one.message.params)) for one in packet.messages]
            address, arguments = self._received.pop(0)
            if address in addresses:
                return arguments

    def ask(self, address: str) -> list[Any]:
        self.send_message(address)
        return self.receive(address)

    def refused(self, packet: bytes) -> str:
        self.send(packet)
        return str(self.receive("/hapsim/error")[0])


@contextlib.contextmanager
def answering(hub: Any, senders: tuple[str, ...] = (), at: str = ":0") -> Iterator[OscView]:
    warnings: list[str] = []
    view = OscView(hub, address_of("--osc-at", at, 0), senders, warnings.append)
    server = Server([view], warnings.append)
    server.start()
    try:
        yield view
    finally:
        server.close()
    assert not any("defect" in one for one in warnings), warnings


@pytest.fixture
def client(serve: Callable[..., Any]) -> Iterator[tuple[Any, Client, OscView]]:
    served = serve(SLOW)
    with answering(served.hub) as view:
        yield served, Client(view), view


class Recorder:
    """Notes what a view would change."""

    def __init__(self) -> None:
        self.made: list[tuple[dict[str, Any], float]] = []
        self.at: list[float] = []
        self.session = object()  # as of a hub whose device is armed
        self.parameters = {
            "touch.stiffness": Parameter("touch.stiffness", "number", 200.0, "N/m", ""),
            "touch.damping": Parameter("touch.damping", "number", 2.0, "N·s/m", ""),
            "mock.hand.force": Parameter("mock.hand.force", "numbers", (0.0, 0.5), "N", ""),
            "knob.shape": Parameter("knob.shape", "word", "sine", "", "", words=("sine", "snap")),
            "table.points": Parameter("table.points", "points", ((0.0, 0.0), (1.0, 1.0)), "", ""),
        }

    def listen(self, _: Any) -> Callable[[], None]:
        return lambda: None

    def set(self, values: dict[str, Any], over: float) -> Future[None]:
        self.made.append((values, over))
        self.at.append(time.time())
        done: Future[None] = Future()
        done.set_result(None)
        return done


@pytest.fixture
def recorded() -> Iterator[tuple[Recorder, Client]]:
    hub = Recorder()
    with answering(hub) as view:
        yield hub, Client(view)


def test_osc_sets_and_reports_parameters(client: tuple[Any, Client, OscView]) -> None:
    served, osc, _ = client
    assert osc.ask("/hapsim/touch/stiffness") == [200.0]
    for i in range(20):
        osc.send_message("/hapsim/touch/stiffness", 150.25 + i, 0.01)
        assert osc.ask("/hapsim/touch/stiffness") == [150.25 + i]
    assert served.hub.parameters["touch.stiffness"].value == 169.25
    osc.send_message("/hapsim/t*/{stiffness,none}", 120)
    assert osc.ask("/hapsim/touch/stiffness") == [120.0]
    osc.send_message("/hapsim/[a-z]ouch/*")
    assert {tuple(osc.receive("/hapsim/touch/stiffness", "/hapsim/touch/damping")) for _ in range(2)} == {
        (120.0,),
        (2.0,),
    }
    assert "-5" in osc.refused(message("/hapsim/touch/stiffness", -5.0).dgram)
    assert osc.ask("/hapsim/touch/stiffness") == [120.0]
    osc.send_message("/hapsim/marker", "here")
    osc.ask("/hapsim/touch/stiffness")
    assert [one.sentence for one in served.hub.events if one.kind == "marker"] == ["here"]
    osc.send(message("/hapsim/pulse", 0, "buzz", 0.5, 0.1, 5).dgram)
    osc.ask("/hapsim/touch/stiffness")
    assert [one.values["shape"] for one in served.hub.events if one.kind == "pulse"] == ["buzz"]
    assert "did you mean 'click'" in osc.refused(message("/hapsim/pulse", 0, "clik", 0.5, 0.01).dgram)
    assert "expected CHANNEL, SHAPE" in osc.refused(message("/hapsim/pulse", 0, "click", 0.5).dgram)
    osc.send(message("/hapsim/s?op").dgram)
    assert "no such address" in osc.receive("/hapsim/error")[0]  # patterns reach parameters only
    assert served.hub.phase == "running"


def test_osc_begins_trials_and_reports_them(client: tuple[Any, Client, OscView]) -> None:
    served, osc, _ = client
    osc.send_message("/hapsim/subscribe", osc.port)
    osc.send_message("/hapsim/trial", 7, "touch.stiffness", 150.0, "over", 0.005)
    number, phase, first = osc.receive("/hapsim/trial")
    assert (number, phase) == (7, "begun")
    assert osc.receive("/hapsim/trial") == [7, "settled", first]  # one sample of 5 ms
    assert osc.ask("/hapsim/touch/stiffness") == [150.0]
    for wrong, found in (
        (("x",), "found x"), ((8, "touch.stiffness"), "found 8 touch.stiffness"), ((8, "code", 1), "code"),
        ((8, "touch.stifness", 1.0), "stifness"), ((8, "restart", "touhc"), "touhc"), ((0,), "number"), ((8.5,), "8.5"),
    ):  # fmt: skip
        assert found in osc.refused(message("/hapsim/trial", *wrong).dgram), wrong
    assert [one.values["trial"] for one in served.hub.events if one.kind == "trial"] == [7, 7]


@pytest.mark.parametrize(
    "packet",
    [
        message("/hapsim/stop").dgram,
        message("/hapsim/stop", 1.0).dgram,  # of a button
        bundle(0, message("/hapsim/stop"), message("/hapsim/nothing")),
        bundle(time.time() + 1e5, message("/hapsim/stop")),  # of a machine whose clock is fast
    ],
    ids=["alone", "with a number", "in a bundle", "in a bundle of later"],
)
@pytest.mark.parametrize("is_away", [False, True])
def test_osc_stops_the_run_in_every_way_of_saying_so(
    client: tuple[Any, Client, OscView], packet: bytes, is_away: bool
) -> None:
    served, osc, _ = client
    if is_away:
        served.pause()
    with served.ending():
        osc.send(packet)


def test_osc_streams_the_state(client: tuple[Any, Client, OscView]) -> None:
    served, osc, view = client
    osc.send_message("/hapsim/subscribe", osc.port, 200)
    ticks = []
    for _ in range(10):
        vectors = {name: osc.receive(f"/hapsim/{name}") for name in ("position", "velocity", "force")}
        assert all(len(one) == 1 and isinstance(one[0], float) for one in vectors.values())
        ticks += osc.receive("/hapsim/ticks")
    assert ticks == sorted(ticks)
    assert ticks[-1] > ticks[0]
    osc.send_message("/hapsim/subscribe", osc.port, 0)
    osc.ask("/hapsim/touch/stiffness")
    assert not view.subscriptions
    gone = Client(view)
    gone.socket.close()
    osc.send_message("/hapsim/subscribe", gone.port)
    osc.ask("/hapsim/touch/stiffness")
    while view.subscriptions:  # until a send finds that nobody listens
        assert served.hub.phase == "running"
        time.sleep(0.01)
    for _ in range(16):
        osc.send_message("/hapsim/subscribe", Client(view).port, 1)
    assert "16 subscriptions" in osc.refused(message("/hapsim/subscribe", osc.port, 10).dgram)
    for arguments in ((70000, 10), (osc.port, 1001), (osc.port, -1), ("no",), ()):
        assert "/hapsim/subscribe: found" in osc.refused(message("/hapsim/subscribe", *arguments).dgram)


def test_each_new_place_of_a_detent_reaches_osc_the_web_and_a_record(serve: Callable[..., Any]) -> None:
    held = "touch: {type: detent, between: [hand, wall], pitch: 0.01, depth: 0.1, hold_until: 0.8, damping: 2}"
    touch = "touch: {type: viscoelastic, between: [hand, wall], stiffness: 200, damping: 2}"
    served = serve(SLOW.replace(touch, held).replace("velocity: 0.1", "velocity: 0"))
    with answering(served.hub) as view, served.client() as web:
        web.ask(type="get")
        osc = Client(view)
        osc.send_message("/hapsim/subscribe", osc.port, 0.02)
        assert osc.receive("/hapsim/touch/place") == [0]
        served.hub.set({"mock.hand.stiffness": 100.0, "mock.hand.damping": 10.0}).result()
        served.hub.set({"mock.hand.position": 0.0275}, 0.5).result()
        for place in (1, 2):
            assert osc.receive("/hapsim/touch/place") == [place]
            assert web.message(type="event", kind="place")["values"] == {"touch.place": place}
        assert served.session.state().places == {"touch": 2}
        assert not any(one.kind == "place" for one in served.hub.events)


def test_osc_bundles_are_one_change(recorded: tuple[Recorder, Client]) -> None:
    hub, osc = recorded
    one, other = "/hapsim/touch/stiffness", "/hapsim/touch/damping"
    osc.send(bundle(0, message(one, 5), message(other, 1.5), message(other, 3.0, 0.5), message(one, 7, 0.5)))
    osc.send_message("/hapsim/mock/hand/force", 1.0, 2.0, 0.25)
    osc.send_message("/hapsim/knob/shape", "snap")
    assert osc.ask("/hapsim/mock/hand/force") == [0.0, 0.5]
    assert osc.ask("/hapsim/knob/shape") == ["sine"]
    assert hub.made == [
        ({"touch.stiffness": 5.0, "touch.damping": 1.5}, 0.02),
        ({"touch.damping": 3.0, "touch.stiffness": 7.0}, 0.5),
        ({"mock.hand.force": [1.0, 2.0]}, 0.25),
        ({"knob.shape": "snap"}, 0.02),
    ]


def test_osc_bundles_wait_for_their_time(recorded: tuple[Recorder, Client]) -> None:
    hub, osc = recorded
    change = message("/hapsim/touch/stiffness", 5.0)
    due = time.time() + 0.3
    osc.send(bundle(due, change))
    osc.send(bundle(time.time() - 10, message("/hapsim/touch/damping", 1.0)))  # late: now
    osc.ask("/hapsim/touch/damping")
    while len(hub.made) < 2:
        time.sleep(0.01)
    assert [next(iter(values)) for values, _ in hub.made] == ["touch.damping", "touch.stiffness"]
    assert hub.at[1] > due - 0.01
    assert "expected at most 60 s" in osc.refused(bundle(time.time() + 65, change))
    for i in range(1000):
        osc.send(bundle(time.time() + 50, change))
        if i % BATCH == 0:
            osc.ask("/hapsim/touch/damping")
    assert "1000 bundles wait" in osc.refused(bundle(time.time() + 50, change))
    assert len(hub.made) == 2


def test_osc_refuses_in_words(recorded: tuple[Recorder, Client]) -> None:
    hub, osc = recorded
    good = message("/hapsim/touch/stiffness", 5.0).dgram
    for packet, sentence in (
        (good[:-2], "cut off"),
        (b"", "cut off"),
        (b"#bundle\0" + bytes(8) + struct.pack(">i", -4) + good, "cut off"),
        (message("/hapsim/touch/stiffness", float("nan")).dgram, "not finite"),
        (message("/hapsim/touch/stiffness", float("inf")).dgram, "not finite"),
        (message("/hapsim/touch/stiffnes", 5.0).dgram, "no such address"),
        (message("/hapsim/table/points", 5.0).dgram, "no such address"),
        (message("/hapsim/touch/stiffness", "much").dgram, "found much, expected a number"),
        (message("/hapsim/touch/stiffness", 1.0, 2.0, 3.0).dgram, "expected a number, and the seconds"),
        (message("/hapsim/mock/hand/force", 1.0).dgram, "expected 2 numbers"),
        (message("/hapsim/knob/shape", 1.0).dgram, "expected a word"),
        (message("/hapsim/marker").dgram, "expected one text"),
    ):
        assert sentence in osc.refused(packet)
    for end in range(1, len(good)):  # python-osc would read some of them as another number
        osc.send(good[:end])
    assert osc.ask("/hapsim/touch/damping") == [2.0]
    assert not hub.made


def test_osc_survives_mutated_packets(client: tuple[Any, Client, OscView]) -> None:
    served, osc, view = client
    before = {name: one.value for name, one in served.hub.parameters.items()}
    asks = [message(one) for one in ("/hapsim/touch/stiffness", "/hapsim/*/damping", "/hapsim/mock/hand/force")]
    valid = [one.dgram for one in (*asks, message("/hapsim/marker", "here"), message("/hapsim/subscribe", 9, 10.0))]
    valid += [message("/hapsim/touch/stiffness", -1.0, -1.0).dgram, message("/hapsim/*/{damping,[a-z]*}", "x").dgram]
    valid += [bundle(0, *asks), bundle(time.time() + 30, *asks)]
    chance = random.Random(35)
    for i in range(PACKETS):
        packet = mutated(chance, chance.choice(valid))
        if not may_set(packet):
            osc.send(packet)
        if i % BATCH == 0:
            assert osc.ask("/hapsim/wall/position") == [0.0]
    assert osc.ask("/hapsim/wall/position") == [0.0]
    assert view.refused > PACKETS / 4
    assert served.hub.phase == "running"
    assert not served.session.wait(0.0)
    assert {name: one.value for name, one in served.hub.parameters.items()} == before


def mutated(chance: random.Random, packet: bytes) -> bytes:
    data = bytearray(packet)
    for _ in range(chance.randint(1, 4)):
        place = chance.randrange(len(data) + 1)
        kind = chance.randrange(4)
        if kind == 0:
            del data[place:]
        elif kind == 1:
            data[place:place] = chance.randbytes(chance.choice((1, 4, 8)))
        elif kind == 2:
            data[place : place + 4] = chance.choice((bytes(4), b"\xff" * 4, b"\x7f\xc0\0\0", b"/*/*", b",ffs"))
        elif place < len(data):
            data[place] ^= 1 << chance.randrange(8)
    return bytes(data)


def may_set(packet: bytes) -> bool:
    """Returns whether python-osc reads a message of one or two numbers, which may be a valid change."""
    try:
        found = [] if packet.startswith(b"#bundle\0") else list(OscMessage(packet))
    except Exception:
        return False
    return len(found) in (1, 2) and all(isinstance(one, int | float) for one in found)


def test_osc_takes_packets_of_listed_senders_only() -> None:
    hub = Recorder()
    with answering(hub, ("127.0.0.1",)) as view:
        Client(view, "127.0.0.2").send_message("/hapsim/touch/stiffness", 5.0)
        osc = Client(view)
        assert osc.ask("/hapsim/touch/stiffness") == [200.0]
        assert not hub.made
        assert not view.refused


def test_osc_names_a_taken_port() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taken:
        taken.bind(("127.0.0.1", 0))
        address = address_of("--osc-at", f":{taken.getsockname()[1]}", 0)
        hub: Any = Recorder()
        with pytest.raises(UsageError, match="--osc-at"):
            Server([OscView(hub, address, (), print)], print).start()


def test_osc_answers_over_ipv6_too() -> None:
    try:
        socket.create_server(("::1", 0), family=socket.AF_INET6).close()
    except OSError:
        pytest.skip("this machine has no IPv6")
    with answering(Recorder(), at="[::1]:0") as view:
        client = Client(view, "::1")
        assert client.ask("/hapsim/touch/stiffness") == [200.0]
        assert "no such address" in client.refused(message("/hapsim/tuch", 1.0).dgram)


def test_osc_reports_at_most_twenty_times_a_second_what_was_wrong(recorded: tuple[Recorder, Client]) -> None:
    _, client = recorded
    begun = time.monotonic()
    for _ in range(100):
        client.send_message("/hapsim/nothing", 1.0)
    client.send_message("/hapsim/touch/stiffness")  # answered after all before it are judged
    errors = 0
    while isinstance(client.receive("/hapsim/error", "/hapsim/touch/stiffness")[0], str):
        errors += 1
    seconds = int(time.monotonic() - begun) + 2  # of the clock, that this may have touched
    assert 20 <= errors <= min(20 * seconds, 99)


def test_osc_goes_on_after_the_device_was_away(client: tuple[Any, Client, OscView]) -> None:
    served, osc, _ = client
    osc.send_message("/hapsim/subscribe", osc.port, 100)
    osc.receive("/hapsim/ticks")
    osc.send_message("/hapsim/touch/stiffness", 150.0)
    assert osc.ask("/hapsim/touch/stiffness") == [150.0]
    served.pause()
    assert "nothing runs" in osc.refused(message("/hapsim/touch/stiffness", 170.0).dgram)
    served.resume()
    while osc.receive("/hapsim/ticks")[0] > 150:
        pass
    assert osc.ask("/hapsim/touch/stiffness") == [150.0]


@pytest.mark.parametrize(
    ("address", "arguments"),
    [
        ("/hapsim/mock/hand/force", [1.0]),  # known once a mock is armed
        ("/hapsim/mock/hand/force", []),
        ("/hapsim/mock/*/force", [1.0]),
        ("/hapsim/touch/stiffness", [150.0]),
        ("/hapsim/*/stiffness", [150.0]),
        ("/hapsim/position", []),
        ("/hapsim/marker", ["here"]),
    ],
)
def test_before_arming_every_refusal_states_that_nothing_is_armed_yet(address: str, arguments: list[Any]) -> None:
    with answering(Hub(parse_scene(SLOW))) as view:
        client = Client(view)
        sentence = client.refused(message(address, *arguments).dgram)
        assert "not armed" in sentence
        assert "no such address" not in sentence
