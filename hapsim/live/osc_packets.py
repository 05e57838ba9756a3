"""OSC packets: bytes into messages with their times, values into bytes, and which addresses a pattern names.

python-osc reads and builds messages. Bundles are taken apart here: its own reader never returns from one whose element
has a negative size, and it recurses as deep as bundles are nested.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Sequence
from fnmatch import fnmatchcase
from functools import lru_cache
from itertools import product
from typing import NamedTuple

from pythonosc import osc_message
from pythonosc.osc_message_builder import OscMessageBuilder
from pythonosc.parsing import osc_types

from hapsim.errors import UsageError

LONGEST = 8192
"""Bytes of a packet that is read."""

Argument = int | float | str

_BUNDLE, _NOW = b"#bundle\0", b"\0\0\0\0\0\0\0\1"
_DEEPEST = 8
_MOST_MESSAGES = 200  # of a packet
_FULL = 1400  # bytes of a bundle that is sent: what one Ethernet frame carries
_TYPES = frozenset("ifdhs")
_LARGEST = 3.4e38  # that f can be
_LONGEST_PATTERN, _MOST_ALTERNATIVES = 200, 100
_WILD, _BRACES = frozenset("?*[]{}"), re.compile(r"\{([^{}/]*)\}")


class Received(NamedTuple):
    """A message of a packet."""

    address: str
    arguments: tuple[Argument, ...]
    due: float
    """Unix time in s at which it is meant; 0 for now."""


def messages_of(packet: bytes) -> list[Received]:
    """Returns the messages of a packet, those of bundles with their bundle's time tag. Raises UsageError."""
    if len(packet) > LONGEST:
        raise UsageError(f"found a packet of more than {LONGEST} bytes, expected fewer: send several")
    try:
        found = []
        for message in _unpacked(packet, 0.0, 0):
            found.append(message)
            if len(found) > _MOST_MESSAGES:
                raise UsageError(f"found a bundle of more than {_MOST_MESSAGES} messages, expected fewer")
        return found
    except (osc_types.ParseError, osc_message.ParseError, ValueError):
        raise UsageError("found a packet that is cut off or not OSC, expected an OSC message or bundle") from None


def _unpacked(packet: bytes, due: float, depth: int) -> Iterator[Received]:
    if not packet.startswith(_BUNDLE):
        yield _message(packet, due)
        return
    if depth == _DEEPEST:
        raise UsageError(f"found more than {_DEEPEST} bundles within each other, expected fewer")
    due, place = osc_types.get_date(packet, len(_BUNDLE))
    while place < len(packet):
        size, place = osc_types.get_int(packet, place)
        if not 0 < size <= len(packet) - place:
            raise ValueError
        yield from _unpacked(packet[place : place + size], due, depth + 1)
        place += size


def _message(packet: bytes, due: float) -> Received:
    address, place = osc_types.get_string(packet, 0)
    if not address.startswith("/"):
        raise ValueError
    types, place = osc_types.get_string(packet, place) if place < len(packet) else (",", place)
    if not types.startswith(","):
        raise ValueError
    if other := set(types[1:]) - _TYPES:
        raise UsageError(f"{shown(address)}: found an argument of type '{shown(min(other))}', expected i, f, d, h or s")
    for one in types[1:]:
        place = osc_types.get_string(packet, place)[1] if one == "s" else place + (4 if one in "if" else 8)
    if place != len(packet):  # python-osc reads zeros where the end is missing
        raise ValueError
    arguments = tuple(osc_message.OscMessage(packet))
    if any(isinstance(one, float) and not math.isfinite(one) for one in arguments):
        raise UsageError(f"{shown(address)}: found a number that is not finite, expected a finite one")
    return Received(address, arguments, due)


def packet_of(address: str, arguments: Sequence[Argument]) -> bytes:
    """Returns a message: whole numbers as i (the lowest 31 bits), others as f, texts as s, as every program reads."""
    builder = OscMessageBuilder(address)
    for one in arguments:
        if isinstance(one, int):
            builder.add_arg(one & 0x7FFFFFFF, builder.ARG_TYPE_INT)
        elif isinstance(one, float):
            builder.add_arg(max(-_LARGEST, min(_LARGEST, one)), builder.ARG_TYPE_FLOAT)
        else:
            builder.add_arg(one, builder.ARG_TYPE_STRING)
    return builder.build().dgram


def bundles_of(messages: Sequence[bytes]) -> Iterator[bytes]:
    """Yields bundles, for now, of these messages; each fits a network's frame if its messages do."""
    bundle = b""
    for message in messages:
        if bundle and len(bundle) + 4 + len(message) > _FULL:
            yield bundle
            bundle = b""
        bundle = (bundle or _BUNDLE + _NOW) + osc_types.write_int(len(message)) + message
    if bundle:
        yield bundle


def shown(text: str) -> str:
    """Returns what was received as a sentence may repeat it: short, and printable ASCII, which OSC's texts are."""
    short = text if len(text) <= 80 else f"{text[:80]}..."
    return short.encode("ascii", "backslashreplace").decode() if short.isprintable() else ascii(short)


def is_pattern(address: str) -> bool:
    """Returns whether an address has wildcards and so may match several."""
    return not _WILD.isdisjoint(address)


def matches(pattern: str, address: str) -> bool:
    """Returns whether an OSC 1.0 pattern (? * [a-z] [!a-z] {one,other}) matches an address. Raises UsageError."""
    names = address.split("/")
    return any(len(parts) == len(names) and all(map(fnmatchcase, names, parts)) for parts in _alternatives(pattern))


@lru_cache(256)
def _alternatives(pattern: str) -> tuple[list[str], ...]:
    """Returns the patterns without {one,other} that a pattern stands for, each by its parts."""
    choices = [piece.split(",") if i % 2 else [piece] for i, piece in enumerate(_BRACES.split(pattern))]
    if len(pattern) > _LONGEST_PATTERN or math.prod(map(len, choices)) > _MOST_ALTERNATIVES:
        most = f"at most {_LONGEST_PATTERN} characters, and {_MOST_ALTERNATIVES} ways to choose from {{one,other}}"
        raise UsageError(f"{shown(pattern)}: found a longer pattern, expected {most}")
    return tuple("".join(chosen).split("/") for chosen in product(*choices))
