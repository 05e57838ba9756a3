"""Addresses of devices behind a network, in place of a serial port: tcp://HOST:PORT and udp://HOST:PORT."""

import re
from typing import NamedTuple

EXPECTED = "tcp://HOST:PORT or udp://HOST:PORT, such as tcp://192.168.7.2:7472 or udp://[fe80::2]:7472"

_ADDRESS = re.compile(r"(tcp|udp)://(?:\[([^\s\[\]]+)\]|([^\s/:@\[\]]+)):([0-9]{1,5})")


class Address(NamedTuple):
    """A place where a device, or the mock, answers. `kind`: tcp or udp; `host`: without brackets."""

    kind: str
    host: str
    port: int

    def __str__(self) -> str:
        return f"{self.kind}://{f'[{self.host}]' if ':' in self.host else self.host}:{self.port}"


def is_address(port: str) -> bool:
    """Returns whether the name of a port is an address, right or wrong, and no serial port's."""
    return "://" in port


def address_of(text: str) -> Address | None:
    """Returns the address that a text is; None for another text."""
    found = _ADDRESS.fullmatch(text)
    return Address(found[1], found[2] or found[3], int(found[4])) if found and int(found[4]) < 1 << 16 else None
