"""OSCQuery: what OSC addresses there are, with their types, ranges and values, over HTTP at OSC's own port number.

It follows the OSCQuery proposal (github.com/Vidvox/OSCQueryProposal). It only reads: values are set by OSC over UDP.
"""

from __future__ import annotations

import asyncio
import contextlib
import importlib.util
import ipaddress
import json
import socket
from collections.abc import Callable, Iterator
from http import HTTPStatus
from typing import Any
from urllib.parse import unquote

from websockets.asyncio.server import Server, ServerConnection
from websockets.exceptions import ConnectionClosed
from websockets.http11 import Request, Response

from hapsim.live.access import why_refused
from hapsim.live.messages import text_of
from hapsim.live.osc import OscView, arguments_of, read_only_values
from hapsim.live.osc_packets import Argument, packet_of
from hapsim.live.server import response, serve_at
from hapsim.running.live_parameters import Parameter

_READS, _READS_AND_WRITES = 1, 3  # ACCESS
_ATTRIBUTES = ("FULL_PATH", "CONTENTS", "TYPE", "ACCESS", "VALUE", "RANGE", "UNIT", "DESCRIPTION", "HOST_INFO")
_EXTENSIONS = ("ACCESS", "VALUE", "RANGE", "UNIT", "DESCRIPTION", "LISTEN")
_LONGEST = 4096  # bytes of a message
_MOST_CLIENTS, _MOST_PATHS = 16, 256
_PERIOD_S = 0.02  # between two looks at what is listened to
_PATIENCE_S = 5.0
_ONLY_READS = 1003
_TRY_LATER = 1013


class OscQueryView:
    """Describes what an `OscView`, which is open, answers."""

    WHAT = "OSCQuery"

    def __init__(self, osc: OscView) -> None:
        self._osc = osc
        self._server: Server
        self._clients = 0
        self._withdraw: Callable[[], Any] | None = None

    @property
    def url(self) -> str:
        """URL of the OSCQuery server."""
        return f"http://{self._osc.address}/"

    async def start(self, _loop: asyncio.AbstractEventLoop) -> None:
        """Begins to listen, at OSC's port. Raises UsageError where it is taken."""
        self._server, _ = await serve_at(self._osc.address, "--osc", self._process, self._serve, _LONGEST)
        if not self._osc.address.is_loopback and importlib.util.find_spec("zeroconf"):
            self._withdraw = await _announced(self._osc.address.ip, self._osc.address.port)

    async def close(self) -> None:
        """Ends that."""
        if self._withdraw is not None:
            await self._withdraw()
        self._server.close()
        await self._server.wait_closed()

    def _process(self, connection: ServerConnection, request: Request) -> Response | None:
        """Answers a request, unless it opens a WebSocket."""
        (path, _, query), headers = request.path.partition("?"), request.headers
        hosts, origins = headers.get_all("Host"), headers.get_all("Origin")
        if why := why_refused(self._osc.address, hosts, origins, needs_origin=False):
            return response(HTTPStatus.FORBIDDEN, why)
        if not self._osc.takes_from(str(connection.remote_address[0])):
            return response(HTTPStatus.FORBIDDEN, "expected an address that --osc-from lists")
        if "Upgrade" in headers:
            return None
        if query and query not in _ATTRIBUTES:
            return response(HTTPStatus.BAD_REQUEST, f"found {query[:40]!r}, expected one of {', '.join(_ATTRIBUTES)}")
        if query == "HOST_INFO":
            return _as_json(self._host_info())
        node = self._node(unquote(path))
        if node is None:
            return response(HTTPStatus.NOT_FOUND, f"{path[:80]!r}: {self._osc.why_unknown()}")
        if query and query not in node:
            return response(HTTPStatus.NO_CONTENT, "")
        return _as_json({query: node[query]} if query else node)

    def _host_info(self) -> dict[str, Any]:
        address = self._osc.address
        at = {"OSC_IP": address.ip, "OSC_PORT": address.port, "WS_IP": address.ip, "WS_PORT": address.port}
        if ipaddress.ip_address(address.ip).is_unspecified:  # every address of this machine: the one that was asked
            at = {"OSC_PORT": address.port, "WS_PORT": address.port}
        name = f"hapsim {self._osc.hub.name}"
        return {"NAME": name, "OSC_TRANSPORT": "UDP", "EXTENSIONS": dict.fromkeys(_EXTENSIONS, True)} | at

    def _node(self, path: str) -> dict[str, Any] | None:
        """The node at a path, with all below it."""
        place = path.rstrip("/")
        leaves = dict(self._leaves())
        if place in leaves:
            return leaves[place]
        node: dict[str, Any] = {"FULL_PATH": place or "/", "ACCESS": 0, "CONTENTS": {}}
        for address, leaf in leaves.items():
            if address.startswith(f"{place}/"):
                *steps, last = address.removeprefix(f"{place}/").split("/")
                inner, at = node, place
                for step in steps:
                    at += f"/{step}"
                    inner = inner["CONTENTS"].setdefault(step, {"FULL_PATH": at, "ACCESS": 0, "CONTENTS": {}})
                inner["CONTENTS"][last] = leaf
        return node if node["CONTENTS"] else None

    def _leaves(self) -> Iterator[tuple[str, dict[str, Any]]]:
        for address, one in self._osc.parameters().items():
            values = arguments_of(one.value)
            about = {"DESCRIPTION": one.description, "ACCESS": _READS_AND_WRITES} | _range(one, len(values))
            named = {"UNIT": [one.unit] * len(values)} if one.unit else {}
            yield address, {"FULL_PATH": address, **_typed(values), **about, **named}
        for address, values, units, description in read_only_values(self._osc.hub):
            about = {"DESCRIPTION": description, "ACCESS": _READS, "UNIT": units}
            yield address, {"FULL_PATH": address, **_typed(values), **about}

    async def _serve(self, connection: ServerConnection) -> None:
        """Takes LISTEN and IGNORE, and sends the values of what is listened to as they change."""
        if self._clients >= _MOST_CLIENTS:
            await connection.close(_TRY_LATER, f"{_MOST_CLIENTS} clients are connected already")
            return
        self._clients += 1
        paths: set[str] = set()
        sending = asyncio.create_task(self._send_changes(connection, paths))
        try:
            async for text in connection:
                if isinstance(text, bytes):
                    await connection.close(_ONLY_READS, "values are set by OSC over UDP")
                    return
                _obey(text, paths)
                await asyncio.sleep(0.001)  # at most a thousand a second
        except ConnectionClosed:
            pass
        finally:
            self._clients -= 1
            sending.cancel()

    async def _send_changes(self, connection: ServerConnection, paths: set[str]) -> None:
        sent: dict[str, list[Argument]] = {}
        with contextlib.suppress(ConnectionClosed, TimeoutError):
            while True:
                sent = {path: values for path, values in sent.items() if path in paths}
                for path, values in self._values(paths):
                    if sent.get(path) != values:
                        sent[path] = values
                        async with asyncio.timeout(_PATIENCE_S):
                            await connection.send(packet_of(path, values))
                await asyncio.sleep(_PERIOD_S)
        connection.transport.abort()

    def _values(self, paths: set[str]) -> Iterator[tuple[str, list[Argument]]]:
        if not paths:
            return
        for address, values, *_ in read_only_values(self._osc.hub):
            if address in paths:
                yield address, values
        for address, one in self._osc.parameters().items():
            if address in paths:
                yield address, arguments_of(one.value)


def _obey(text: str, paths: set[str]) -> None:
    """Takes a command; what is none, or asks for too much, is ignored, as the proposal has no answer to it."""
    try:
        command = json.loads(text)
        kind, path = command["COMMAND"], command["DATA"]
    except (ValueError, TypeError, KeyError, RecursionError):
        return
    if kind == "LISTEN" and isinstance(path, str) and len(paths) < _MOST_PATHS:
        paths.add(path)
    elif kind == "IGNORE" and isinstance(path, str):
        paths.discard(path)


def _typed(values: list[Argument]) -> dict[str, Any]:
    letters = "".join("s" if isinstance(one, str) else "i" if isinstance(one, int) else "f" for one in values)
    return {"TYPE": letters, "VALUE": values}


def _range(one: Parameter, count: int) -> dict[str, Any]:
    if one.words:
        return {"RANGE": [{"VALS": list(one.words)}]}
    ends = one.range or (one.least, one.most)
    bounds = {name: value for name, value in zip(("MIN", "MAX"), ends, strict=True) if value is not None}
    return {"RANGE": [bounds] * count} if bounds else {}


def _as_json(document: dict[str, Any]) -> Response:
    return response(HTTPStatus.OK, text_of(document), "application/json")


async def _announced(ip: str, port: int) -> Callable[[], Any]:
    """Announces the service by mDNS; returns what withdraws it."""
    from zeroconf import get_all_addresses  # type: ignore[import-not-found]
    from zeroconf.asyncio import AsyncServiceInfo, AsyncZeroconf  # type: ignore[import-not-found]

    every = ipaddress.ip_address(ip).is_unspecified
    addresses = [ipaddress.ip_address(one).packed for one in (get_all_addresses() if every else [ip])]
    kind = "_oscjson._tcp.local."
    info = AsyncServiceInfo(kind, f"hapsim {socket.gethostname()}.{kind}", port, addresses=addresses)
    announcer = AsyncZeroconf()
    await announcer.async_register_service(info)
    return announcer.async_close
