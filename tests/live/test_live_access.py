"""Access to a running scene: Host, Origin, token, limits, clients that misbehave."""

from __future__ import annotations

import asyncio
import contextlib
import http.client
import json
import logging
import socket
import struct
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import pytest
from live_clients import Client, Served
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import connect

from hapsim.errors import UsageError
from hapsim.live import server, web
from hapsim.live.access import TOKEN_VARIABLE, address_of, has_token, new_token, why_refused
from hapsim.live.server import Server
from hapsim.live.web import MOST_CLIENTS, WebView

LOOPBACK, ANYWHERE = (address_of("--serve-at", text, 7470) for text in (None, "0.0.0.0"))


class Answer(NamedTuple):
    """Answer of a server to a GET."""

    status: int
    headers: http.client.HTTPMessage
    body: bytes


def ask(served: Served, path: str, **headers: str) -> Answer:
    connection = http.client.HTTPConnection("127.0.0.1", served.view.address.port, timeout=30)
    connection.request("GET", path, headers={"Host": f"localhost:{served.view.address.port}", **headers})
    with contextlib.closing(connection), connection.getresponse() as response:
        return Answer(response.status, response.headers, response.read())


@pytest.mark.parametrize(
    ("host", "origin", "refused"),
    [
        ("127.0.0.1:7470", "http://127.0.0.1:7470", ""),
        ("localhost:7470", "http://localhost:7470", ""),
        ("LOCALHOST:7470", "http://localhost:7470", ""),
        ("[::1]:7470", "http://[::1]:7470", ""),
        ("localhost:9000", "http://localhost:9000", ""),  # through a tunnel
        ("127.0.0.1:7470", "http://localhost:7470", "Origin"),
        ("127.0.0.1:7470", "http://127.0.0.1:8000", "Origin"),
        ("127.0.0.1:7470", "http://evil.example", "Origin"),
        ("127.0.0.1:7470", "null", "Origin"),
        ("127.0.0.1:7470", None, "Origin"),
        ("127.0.0.1:7470", "http://127.0.0.1:7470.evil.example", "Origin"),
        ("evil.example:7470", "http://evil.example:7470", "Host"),  # DNS rebinding
        ("localhost.evil.example", "http://localhost.evil.example", "Host"),
        ("192.168.0.7:7470", "http://192.168.0.7:7470", "Host"),
        ("user@localhost", "http://user@localhost", "Host"),
        ("localhost:x", "http://localhost:x", "Host"),
        ("", "http://", "Host"),
        (None, "http://localhost", "Host"),
    ],
)
def test_only_the_page_itself_may_connect_to_a_scene(host: str | None, origin: str | None, refused: str) -> None:
    hosts, origins = ([one] if one is not None else [] for one in (host, origin))
    assert why_refused(LOOPBACK, hosts, origins, needs_origin=True).partition(":")[0] == refused
    assert why_refused(LOOPBACK, hosts * 2, origins, needs_origin=True) != ""
    without = why_refused(LOOPBACK, hosts, [], needs_origin=False).partition(":")[0]
    assert without == (refused if refused == "Host" else "")


def test_beyond_this_machine_addresses_and_its_own_name_are_hosts_and_other_names_are_not() -> None:
    for host in ("192.168.0.7:7470", f"{socket.gethostname()}:7470", f"{socket.gethostname()}.local:7470", "localhost"):
        assert why_refused(ANYWHERE, [host], [f"http://{host}"], needs_origin=True) == ""
    assert why_refused(ANYWHERE, ["evil.example"], ["http://evil.example"], needs_origin=True) != ""


def test_the_token_is_in_the_query_or_in_the_cookie() -> None:
    assert has_token("secret", "hapsim-7470", "token=secret", [])
    assert has_token("secret", "hapsim-7470", "", ["a=b; hapsim-7470=secret"])
    for query, cookie in (
        ("token=secre", "hapsim-7471=secret"),
        ("", ""),
        ("token=\udcff", "\udcff"),
        ("a&" * 99, "=;"),
    ):
        assert not has_token("secret", "hapsim-7470", query, [cookie])


def test_a_token_may_outlive_a_restart_and_is_not_short(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv(TOKEN_VARIABLE, raising=False)
    assert new_token() != new_token()
    monkeypatch.setenv(TOKEN_VARIABLE, "a-token_of-our-own-3")
    assert new_token() == "a-token_of-our-own-3"
    for wrong in ("short", "with spaces and more", "ünïcödé-ünïcödé-ü", 'quotes"and;semicolons'):
        monkeypatch.setenv(TOKEN_VARIABLE, wrong)
        with pytest.raises(UsageError, match="16 or more letters"):
            new_token()


def test_a_page_from_elsewhere_gets_nothing(shared: Served) -> None:
    assert ask(shared, "/").status == 200
    for headers in ({"Host": "evil.example"}, {"Origin": "http://evil.example"}):
        answer = ask(shared, "/", **headers)
        assert answer.status == 403
        assert b"expected" in answer.body
    for options in ({"origin": "http://evil.example"}, {"origin": None}):
        with pytest.raises(InvalidStatus, match="403"), shared.client(**options):
            pass


def test_the_page_is_served_and_nothing_else(shared: Served) -> None:
    page, found = ask(shared, "/"), ask(shared, "/schema.json")
    assert page.headers["Content-Type"] == "text/html; charset=utf-8"
    assert "default-src 'self'" in page.headers["Content-Security-Policy"]
    assert b"hapsim" in page.body
    assert json.loads(found.body)["title"] == "Messages of a running hapsim"
    for path in ("/../server.py", "/%2e%2e/server.py", "//etc/passwd", "/page", "/\0", "/["):
        assert ask(shared, path.replace("\0", "%00")).status == 404


def test_beyond_this_machine_a_token_is_required(serve: Callable[..., Served]) -> None:
    served = serve(address="0.0.0.0:0")
    port, (_, _, token) = served.view.address.port, served.view.url.partition("token=")
    assert len(token) > 16
    for path in ("/", "/?token=", "/?token=wrong", "/schema.json"):
        assert ask(served, path).status == 401
    with pytest.raises(InvalidStatus, match="401"), served.client():
        pass
    first = ask(served, f"/?token={token}")
    cookie, _, rest = first.headers["Set-Cookie"].partition(";")
    assert (first.status, first.headers["Location"], rest) == (303, "/", " HttpOnly; SameSite=Lax; Path=/")
    assert ask(served, "/", Cookie=cookie).status == 200
    assert ask(served, "/", Cookie=cookie.replace(token, "wrong")).status == 401
    with served.client(additional_headers={"Cookie": cookie}) as client:
        assert client.ask(type="get")["type"] == "model"
    with connect(f"ws://127.0.0.1:{port}/live?token={token}", origin=served.origin) as socket:  # type: ignore[arg-type]
        assert Client(socket).ask(type="get")["type"] == "model"


def test_more_clients_than_allowed_get_an_error(serve: Callable[..., Served]) -> None:
    served = serve()
    with contextlib.ExitStack() as stack:
        for _ in range(MOST_CLIENTS):
            stack.enter_context(served.client()).ask(type="get")
        with served.client() as client, pytest.raises(ConnectionClosed, match=f"{MOST_CLIENTS} clients are connected"):
            client.next()
    assert ask(served, "/").status == 200


def test_half_open_and_broken_connections_leave_the_others_alone(serve: Callable[..., Served]) -> None:
    served = serve()
    to = "127.0.0.1", served.view.address.port
    with served.client() as client, contextlib.ExitStack() as stack:
        half_open = [stack.enter_context(socket.create_connection(to)) for _ in range(60)]
        for one, text in zip(
            half_open, (b"GET", b"\0" * 99, b"POST / HTTP/1.1\r\n\r\n", b"GET / HTTP/1.1\r\n"), strict=False
        ):
            one.sendall(text)
        assert client.ask(type="get")["type"] == "model"
        stack.close()
        with served.raw() as reset:
            reset.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
        assert client.ask(type="get")["type"] == "model"
    with served.client() as client:
        assert client.ask(type="get")["type"] == "model"
    assert not served.warnings


def test_what_asyncio_logs_of_the_server_is_not_printed_and_what_it_logs_elsewhere_is(
    serve: Callable[..., Served], caplog: pytest.LogCaptureFixture
) -> None:
    """It logs every write to a client that is gone: 4500 lines for 20 000 pings."""
    served, logged = serve(), threading.Event()
    warn = logging.getLogger("asyncio").warning
    served.view._call(lambda: (warn("socket.send() raised exception."), logged.set()))
    assert logged.wait(30)
    warn("of a program's own")
    assert [one.message for one in caplog.records] == ["of a program's own"]


def test_a_client_that_reads_nothing_is_dropped_with_a_message(
    serve: Callable[..., Served], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(web, "PATIENCE_S", 0.1)
    monkeypatch.setattr(web, "MESSAGES_PER_S", 1e9)
    monkeypatch.setattr(server, "_SEND_BUFFER", 1 << 14)
    served = serve()
    slow = socket.socket()
    slow.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
    slow.connect(("127.0.0.1", served.view.address.port))
    with served.client() as other, served.client(sock=slow, max_queue=1, close_timeout=0.1) as client:
        other.ask(type="subscribe", rate=100)
        for number in range(20_000):  # each answered by a model that nobody takes
            try:
                client.send(type="get", id=number)
            except ConnectionClosed:
                break
            if served.warnings:
                break
        while not served.warnings:
            other.block()
        assert "reads too slowly" in served.warnings[0]
        first = other.block().first
        assert other.block().first > first
        other.ask(type="subscribe", rate=0)


def test_a_flood_of_messages_is_read_no_faster_than_allowed(
    serve: Callable[..., Served], monkeypatch: pytest.MonkeyPatch
) -> None:
    waits: list[float] = []

    async def note(seconds: float) -> None:
        waits.append(seconds)

    monkeypatch.setattr(web, "MESSAGES_PER_S", 10.0)
    monkeypatch.setattr(web, "asyncio", _With(asyncio, sleep=note))
    with serve().client() as client:
        for _ in range(100):
            client.send(type="get")
        for _ in range(100):
            client.message(type="model")
    assert len(waits) >= 50
    assert min(waits) > 0


class _With:
    """A module with other functions."""

    def __init__(self, module: Any, **others: Any) -> None:
        self.__dict__ |= {**vars(module), **others}


def test_a_port_in_use_is_an_error_before_anything_is_armed(
    shared: Served, hapsim: Callable[..., Any], tmp_path: Path
) -> None:
    address = str(shared.view.address)
    with pytest.raises(UsageError, match="cannot be listened to: Address already in use"):
        Server([WebView(shared.hub, shared.view.address, print)], print).start()
    scene = tmp_path / "scene.yaml"
    scene.write_text("version: 1\nrate: 1000\ndevice: {mass: 0.2}\nmodules:\n  hand: {type: device, channel: 0}\n")
    assert address in hapsim("run", scene, "--serve-at", address, "--duration", 1).sentence


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (("--serve-at", "nowhere.invalid:3"), "found 'nowhere.invalid', expected the name or the address"),
        (("--serve-at", "127.0.0.1:x"), "expected HOST:PORT"),
        (("--serve-at", "127.0.0.1:99999"), "expected HOST:PORT"),
        (("--serve-at", "http://127.0.0.1"), "expected HOST:PORT"),
        (("--serve-at", "192.0.2.1:80"), "Cannot assign requested address"),
        (("--record-dir", "."), "--record-dir needs --serve"),
        (("--serve", "--record-dir", "/nowhere"), "no such directory"),
        (("--osc-at", "0.0.0.0"), "--osc-from is missing"),
        (("--osc-from", "127.0.0.1"), "--osc-from needs --osc"),
        (("--osc", "--osc-from", "localhost"), "expected an IP address"),
    ],
)
def test_a_wrong_option_is_an_error_with_what_was_expected(
    hapsim: Callable[..., Any], options: tuple[str, ...], said: str
) -> None:
    answer = hapsim("run", "first_touch", "--mock", *options, "--duration", 1)
    assert (answer.status, said in answer.sentence) == (2, True), answer.err


def test_without_the_packages_the_command_that_installs_them_is_named(
    hapsim: Callable[..., Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("importlib.util.find_spec", lambda _: None)
    assert "pip install 'hapsim[live]'" in hapsim("run", "first_touch", "--mock", "--serve").sentence
