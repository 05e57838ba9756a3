"""The options of `hapsim run` that serve a running scene to browsers and other programs."""

from __future__ import annotations

import contextlib
import importlib.util
import ipaddress
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from hapsim.cli.options import flag, names, option
from hapsim.cli.output import complain
from hapsim.errors import UsageError

if TYPE_CHECKING:
    from hapsim.live.hub import Hub
    from hapsim.live.server import View
    from hapsim.scene import Scene


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
    osc: Annotated[bool, flag("--osc", "Answer OSC over UDP and OSCQuery, for this machine alone.")] = False
    osc_at: Annotated[str | None, option("HOST:PORT", "Answer them at this address [default: 127.0.0.1:7471].")] = None
    osc_from: Annotated[
        list[str] | None, option("IP,…", "Addresses whose OSC is taken; required beyond this machine.")
    ] = None

    @contextlib.contextmanager
    def serving(self, scene: Scene, gives_way: bool) -> Iterator[Hub | None]:
        """While open, serves the scene in the ways that were asked for. Gives the hub that the run has to keep up to
        date; None where nothing was asked for. `gives_way`: the loop is compiled. Raises UsageError."""
        self._require_sound()
        if not self._serves and not self._answers_osc:
            yield None
            return
        for package in ("websockets", "pythonosc"):
            if importlib.util.find_spec(package) is None:
                raise UsageError(
                    f"--serve and --osc: found no Python package {package}, expected it: pip install 'hapsim[live]'"
                )
        from hapsim.live.hub import Hub
        from hapsim.live.server import Server

        hub = Hub(scene, self.record_dir)
        views = self._views(hub)
        server = Server(views, gives_way)
        server.start()
        try:
            for url in (view.url for view in views if view.url):
                complain(f"Serving at {url}", "serving", "info", url=url)
            yield hub
        finally:
            server.close()

    @property
    def _serves(self) -> bool:
        return self.serve or self.serve_at is not None

    @property
    def _answers_osc(self) -> bool:
        return self.osc or self.osc_at is not None

    def _views(self, hub: Hub) -> list[View]:
        from hapsim.live.access import address_of

        views: list[View] = []
        if self._serves:
            from hapsim.live import web

            page = web.WebView(hub, address_of("--serve-at", self.serve_at, web.PORT), _warn)
            views.append(page)
        if self._answers_osc:
            from hapsim.live import osc, oscquery

            address, senders = address_of("--osc-at", self.osc_at, osc.PORT), tuple(names(self.osc_from))
            if not address.is_loopback and not senders:
                raise UsageError(f"--osc-at {address}: found no --osc-from, expected the addresses whose OSC is taken")
            views += [kind(hub, address, senders, _warn) for kind in (osc.OscView, oscquery.OscQueryView)]
        return views

    def _require_sound(self) -> None:
        if self.record_dir is not None and not self._serves:
            raise UsageError("--record-dir: found no --serve, from whose page records are begun; expected both")
        if self.record_dir is not None and not self.record_dir.is_dir():
            raise UsageError(f"--record-dir {self.record_dir}: found no directory there, expected one")
        if self.osc_from and not self._answers_osc:
            raise UsageError("--osc-from: found no --osc, which takes their packets; expected both")
        for one in names(self.osc_from):
            try:
                ipaddress.ip_address(one)
            except ValueError:
                raise UsageError(f"--osc-from: found '{one}', expected an IP address, or several with commas") from None


def _warn(sentence: str) -> None:
    complain(sentence, "live", "warning")
