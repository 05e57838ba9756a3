"""OSC over UDP: a running scene for Pd, SuperCollider, Max and whatever else speaks it."""

from __future__ import annotations

import asyncio
from collections.abc import Callable

from hapsim.live.access import Address
from hapsim.live.hub import Hub


class OscView:
    """Serves a hub. `senders`: the addresses whose packets are taken; none for loopback. `report`: prints a warning."""

    def __init__(self, hub: Hub, address: Address, senders: tuple[str, ...], report: Callable[[str], None]) -> None:
        self.hub, self.address, self.senders, self.report = hub, address, senders, report

    @property
    def url(self) -> str:
        """Where it is."""
        return f"osc.udp://{self.address}"

    async def start(self, loop: asyncio.AbstractEventLoop) -> None:
        """Begins to listen."""

    async def close(self) -> None:
        """Ends that."""
