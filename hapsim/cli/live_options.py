"""The options of `hapsim run` that serve a running scene to browsers and other programs."""

from __future__ import annotations

import contextlib
import importlib.util
import ipaddress
import os
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from hapsim.cli.options import flag, names, option
from hapsim.cli.output import complain
from hapsim.errors import UsageError

if TYPE_CHECKING:
    from hapsim.live.access import Address
    from hapsim.live.hub import Hub
    from hapsim.live.server import View
    from hapsim.scene import Scene

_PORT, _OSC_PORT = 7470, 7471


@dataclass
class LiveOptions:
    """Who may see and change the scene while it runs, and where."""

    serve: Annotated[bool, flag("--serve", "Serve a page for browsers and a WebSocket, for this machine alone.")] = (
        False
    )
    serve_at: Annotated[
        str | None, option("HOST:PORT", "Serve them at this address [default: 127.0.0.1:7470]; others need a token.")
    ] = None
    record_dir: Annotated[Path | None, option("DIR", "Directory for records that are begun from the page.")] = None
    osc: Annotated[bool, flag("--osc", "Answer OSC over UDP, and OSCQuery over TCP, for this machine alone.")] = False
    osc_at: Annotated[str | None, option("HOST:PORT", "Answer it at this address [default: 127.0.0.1:7471].")] = None
    osc_from: Annotated[
        list[str] | None, option("IP,…", "Addresses whose OSC is taken; required beyond this machine.")
    ] = None

    @contextlib.contextmanager
    def serving(self, scene: Scene, name: str, gives_way: bool) -> Iterator[Hub | None]:
        """While open, serves the scene in the ways that were asked for. Gives the hub that the run has to keep up to
        date; None where nothing was asked for. `name`: what the command calls the scene. `gives_way`: the loop is
        compiled. Raises UsageError."""
        page, osc = self._addresses()
        if page is None and osc is None:
            yield None
            return
        for package in ("websockets", "pythonosc"):
            if importlib.util.find_spec(package) is None:
                raise UsageError(
                    f"--serve and --osc: found no Python package {package}, expected it: pip install 'hapsim[live]'"
                )
        from hapsim.live.hub import Hub
        from hapsim.live.server import Server

        hub = Hub(scene, self.record_dir, name)
        views = self._views(hub, page, osc)
        server = Server(views, _warn, gives_way)
        server.start()
        try:
            for url in (view.url for view in views if view.url):
                complain(f"Serving at {url}", "serving", "info", url=url)
            yield hub
        finally:
            server.close()

    def words(self) -> list[str]:
        """Returns the options as a command has them. Raises UsageError where they contradict each other."""
        self._addresses()
        words = ["--serve"] * self.serve + ["--osc"] * self.osc
        given = ("--serve-at", self.serve_at), ("--osc-at", self.osc_at), ("--osc-from", ",".join(names(self.osc_from)))
        for name, value in (*given, ("--record-dir", self.record_dir and os.path.abspath(self.record_dir))):
            words += [name, str(value)] if value else []
        return words

    def _views(self, hub: Hub, page: Address | None, osc: Address | None) -> list[View]:
        views: list[View] = []
        if page is not None:
            from hapsim.live.web import WebView

            views.append(WebView(hub, page, _warn))
        if osc is not None:
            from hapsim.live.osc import OscView
            from hapsim.live.osc_query import OscQueryView

            view = OscView(hub, osc, tuple(names(self.osc_from)), _warn)
            views += [view, OscQueryView(view)]
        return views

    def _addresses(self) -> tuple[Address | None, Address | None]:
        """Returns where the page and where OSC is served; None for what is not. Raises UsageError."""
        serves, answers_osc = self.serve or self.serve_at is not None, self.osc or self.osc_at is not None
        if self.record_dir is not None and not serves:
            raise UsageError("--record-dir: found no --serve, from whose page records are begun; expected both")
        if self.record_dir is not None and not self.record_dir.is_dir():
            raise UsageError(f"--record-dir {self.record_dir}: found no directory there, expected one")
        if self.osc_from and not answers_osc:
            raise UsageError("--osc-from: found no --osc, which takes their packets; expected both")
        for one in names(self.osc_from):
            try:
                ipaddress.ip_address(one)
            except ValueError:
                raise UsageError(f"--osc-from: found '{one}', expected an IP address, or several with commas") from None
        if not serves and not answers_osc:
            return None, None
        from hapsim.live.access import address_of

        page = address_of("--serve-at", self.serve_at, _PORT) if serves else None
        osc = address_of("--osc-at", self.osc_at, _OSC_PORT) if answers_osc else None
        if osc is not None and not osc.is_loopback and not self.osc_from:
            raise UsageError(f"--osc-at {osc}: found no --osc-from, expected the addresses whose OSC is taken")
        return page, osc


def _warn(sentence: str) -> None:
    complain(sentence, "live", "warning")
