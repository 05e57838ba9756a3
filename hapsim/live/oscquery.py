"""OSCQuery over TCP, on the port number of OSC: what there is, with type, range, unit and value."""

from __future__ import annotations

import asyncio
from collections.abc import Callable

from hapsim.live.access import Address
from hapsim.live.hub import Hub


class OscQueryView:
    """Serves a hub; arguments as of `OscView`."""

    def __init__(self, hub: Hub, address: Address, senders: tuple[str, ...], report: Callable[[str], None]) -> None:
        self.hub, self.address, self.senders, self.report = hub, address, senders, report

    @property
    def url(self) -> str:
        """Where it is."""
        return f"http://{self.address}/"

    async def start(self, loop: asyncio.AbstractEventLoop) -> None:
        """Begins to listen."""

    async def close(self) -> None:
        """Ends that."""
