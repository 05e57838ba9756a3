"""Leases of clients: over the WebSocket and OSC, each the one's that asked, whatever becomes of its connection."""

from __future__ import annotations

import socket
import time
from collections.abc import Callable
from typing import Any

import pytest
from live_clients import SOFT, Client, Served
from test_live_osc import answering

from hapsim.errors import UsageError
from hapsim.live.osc_packets import messages_of, packet_of

Serve = Callable[..., Served]


def news(client: Client, sentence: str) -> dict[str, Any]:
    """The event of the lease with this sentence, which may have come before an answer."""
    heard = [one for one in client.heard if one.get("kind") == "lease" and one["sentence"] == sentence]
    return heard[0] if heard else client.message(type="event", kind="lease", sentence=sentence)


def test_a_lease_outlives_its_client_and_runs_out(serve: Serve) -> None:
    served = serve(SOFT)
    with served.client() as other:
        other.ask(type="get")
        with served.client() as one:
            assert one.ask(type="lease", seconds=1000)["type"] == "done"
            assert news(other, "begun")["values"] == {"seconds": 1000.0, "out": 0}
            refused = other.ask(type="lease", seconds=1.0)
            assert "another client holds the lease" in refused["reason"]
            assert one.ask(type="lease", seconds=0.3)["type"] == "done"
        assert news(other, "ran out: the fallback takes over")["values"]["out"] == 1
        assert other.ask(type="get")["lease"] == {"seconds": 0.3, "out": 1}
        refused = other.ask(type="set", values={"touch.stiffness": 21.0})
        assert "the lease has run out" in refused["reason"]
        assert other.ask(type="lease")["type"] == "done"
        assert news(other, "renewed")["values"]["out"] == 0
        while not other.ask(type="get")["lease"]["out"]:
            pass
        assert other.ask(type="lease", seconds=0)["type"] == "done"
        assert other.ask(type="get")["lease"] == {"seconds": None, "out": 0}
        assert other.ask(type="set", values={"touch.stiffness": 21.0})["type"] == "done"


def test_a_fallback_is_sent_as_text(serve: Serve) -> None:
    served = serve(SOFT)
    with served.client() as client:
        wrong = client.ask(type="lease", seconds=1.0, fallback=SOFT.replace("rate: 1000", "rate: 500"))
        assert "another rate" in wrong["reason"]
        assert (
            client.ask(type="lease", seconds=1.0, fallback=SOFT.replace("damping: 5", "damping: 6"))["type"] == "done"
        )
        again = client.ask(type="lease", seconds=1.0, fallback=SOFT)
        assert "end the lease first" in again["reason"]
    assert served.session._live.lease.fallback is not None


def test_a_program_asks_for_one(serve: Serve) -> None:
    session = serve(SOFT).session
    with pytest.raises(UsageError, match="found no lease to renew"):
        session.renew()
    session.lease(1000.0)
    session.renew()
    assert session.lease_state == {"seconds": 1000.0, "out": 0}
    session.lease(None)
    session.lease(None)
    assert session.lease_state == {"seconds": None, "out": 0}


def test_osc_asks_by_its_address(serve: Serve) -> None:
    served = serve(SOFT)
    with answering(served.hub) as view, socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
        sender.bind(("127.0.0.1", 0))
        sender.settimeout(20.0)
        to = (view.address.ip, view.address.port)
        sender.sendto(packet_of("/hapsim/lease", [1000.0]), to)
        end = time.monotonic() + 20.0
        while served.session.lease_state["seconds"] != 1000.0:
            assert time.monotonic() < end
            time.sleep(1e-3)
        with pytest.raises(UsageError, match="another client holds the lease"):
            served.session.renew()
        sender.sendto(packet_of("/hapsim/lease", [1e-3]), to)
        (answer,) = messages_of(sender.recv(4096))
        assert "s, expected 0.005 to 3600 s" in str(answer.arguments[0])
        sender.sendto(packet_of("/hapsim/lease", [0]), to)
        while served.session.lease_state["seconds"] is not None:
            assert time.monotonic() < end
            time.sleep(1e-3)
