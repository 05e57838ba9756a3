"""Access control of every network view: addresses, the headers Host and Origin, the token.

Any web page may open http://127.0.0.1:7470 in a visitor's browser, but it cannot choose the headers. `Origin` names the
page's own site, and `Host` keeps the page's name even if its owner points that name here.
"""

from __future__ import annotations

import hmac
import ipaddress
import os
import secrets
import socket
from collections.abc import Sequence
from http.cookies import CookieError, SimpleCookie
from typing import Any, NamedTuple
from urllib.parse import parse_qs, urlsplit

from hapsim.errors import UsageError

TOKEN_VARIABLE = "HAPSIM_TOKEN"
"""The environment variable that names a token which outlives a restart."""

_LOOPBACK = "127.0.0.1"
_SHORTEST_TOKEN = 16


class Address(NamedTuple):
    """Listening address of a view."""

    host: str
    """Host name or address as requested."""
    ip: str
    """IP address that the host resolves to."""
    port: int

    @property
    def is_loopback(self) -> bool:
        """True if only this machine can reach the address."""
        return ipaddress.ip_address(self.ip).is_loopback

    def __str__(self) -> str:
        return f"[{self.host}]:{self.port}" if ":" in self.host else f"{self.host}:{self.port}"


def address_of(option: str, text: str | None, port: int) -> Address:
    """Returns the address of HOST:PORT, HOST or :PORT (None: loopback). `port`: the default. Raises UsageError."""
    try:
        parts = urlsplit(f"//{text or _LOOPBACK}")
        host, port = parts.hostname or _LOOPBACK, port if parts.port is None else parts.port
        if parts.path or parts.query or parts.fragment or parts.username is not None:
            raise ValueError
    except ValueError:
        raise UsageError(
            f"{option}: found '{text}', expected HOST:PORT, such as 0.0.0.0:{port} or [::1]:{port}"
        ) from None
    try:
        return Address(host, str(socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0][4][0]), port)
    except (OSError, UnicodeError):
        raise UsageError(f"{option}: found '{host}', expected the name or the address of this machine") from None


def ip_of(address: str) -> Any:
    """Returns the IP address of the end of a connection; an IPv4 address in one of IPv6 is that."""
    ip: Any = ipaddress.ip_address(address.partition("%")[0])
    return getattr(ip, "ipv4_mapped", None) or ip


def new_token() -> str:
    """Returns the token of the environment, or a new one. Raises UsageError for one that is too short."""
    token = os.environ.get(TOKEN_VARIABLE) or secrets.token_urlsafe(16)
    if len(token) < _SHORTEST_TOKEN or not token.replace("-", "").replace("_", "").isalnum() or not token.isascii():
        raise UsageError(
            f"{TOKEN_VARIABLE}: found {len(token)} characters, expected {_SHORTEST_TOKEN} or more letters and digits"
        )
    return token


def why_refused(address: Address, hosts: Sequence[str], origins: Sequence[str], needs_origin: bool) -> str:
    """Returns why a request with these headers Host and Origin is refused; "" where it is not. `needs_origin`: one
    without is refused too."""
    name = _hostname(hosts[0]) if len(hosts) == 1 else None
    if name is None or not (_is_address(address, name) or name in _names(address)):
        found = f"'{hosts[0][:80]}'" if hosts else "none"
        return f"Host: found {found}, expected {address}: a page that has its name point here is refused"
    if not origins and not needs_origin:
        return ""
    expected = hosts[0].lower()
    if len(origins) != 1 or origins[0].lower() not in (f"http://{expected}", f"https://{expected}"):
        found = f"'{origins[0][:80]}'" if origins else "none"
        return f"Origin: found {found}, expected http://{hosts[0]}: pages from elsewhere are refused"
    return ""


def has_token(token: str, name: str, query: str, cookies: Sequence[str]) -> bool:
    """Returns whether a request carries the token in its query or in the cookie of this name."""
    given = parse_qs(query, max_num_fields=10).get("token", []) if query.count("&") < 10 else []
    for text in cookies:
        try:
            cookie = SimpleCookie(text).get(name)
        except CookieError:
            continue
        given += [cookie.value] if cookie is not None else []
    return any(hmac.compare_digest(one.encode(errors="replace"), token.encode()) for one in given)


def _hostname(host: str) -> str | None:
    """The name in a header Host, without its port; None where there is none."""
    try:
        parts = urlsplit(f"//{host}")
        return parts.hostname if parts.netloc == host and parts.port != 0 and "@" not in host else None
    except ValueError:
        return None


def _is_address(address: Address, name: str) -> bool:
    """Returns whether a name is an IP address. Unlike a domain name, nobody can point it elsewhere."""
    try:
        found = ipaddress.ip_address(name)
    except ValueError:
        return False
    return found.is_loopback or not address.is_loopback


def _names(address: Address) -> set[str]:
    own = set() if address.is_loopback else {socket.gethostname().lower(), f"{socket.gethostname().lower()}.local"}
    return {"localhost", address.host.lower(), *own}
