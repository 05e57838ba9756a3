"""OSC over UDP: a running scene for Pd, SuperCollider, Max and whatever else speaks it."""

from __future__ import annotations

import asyncio
import contextlib
import ipaddress
import itertools
import os
import socket
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future
from typing import Any

from hapsim.errors import HapsimError, UsageError
from hapsim.live.access import Address, ip_of
from hapsim.live.hub import Hub
from hapsim.live.osc_packets import Argument, Received, bundles_of, is_pattern, matches, messages_of, packet_of, shown
from hapsim.live.server import free_port
from hapsim.running.live_parameters import Parameter
from hapsim.running.session import Session
from hapsim.running.session_view import Event

ROOT = "/hapsim/"
STOP = f"{ROOT}stop"
"""Address that ends the run, whatever the message's arguments and time."""
LEASE, TRIAL, PULSE = f"{ROOT}lease", f"{ROOT}trial", f"{ROOT}pulse"
_OVER_S = 0.02  # of a change that names no ramp
_FURTHEST_S, _MOST_WAITING = 60.0, 1000  # what is meant for later
_RATE, _HIGHEST_RATE = 50.0, 1000.0  # Hz
_MOST_SUBSCRIPTIONS = 16
_LONGEST_MARKER = 1000  # characters
_MOST_ERRORS = 20  # answered a second
_MOST_UNSENT = 1 << 20  # bytes; answers beyond are dropped


class OscView(asyncio.DatagramProtocol):
    """Serves a hub. `senders`: the addresses whose packets are taken; none for loopback. `report`: prints a warning."""

    WHAT = "OSC"

    def __init__(self, hub: Hub, address: Address, senders: tuple[str, ...], report: Callable[[str], None]) -> None:
        self.hub, self.address, self.report = hub, address, report
        self.refused = 0
        """Number of rejected packets and messages."""
        self._senders = {ipaddress.ip_address(one) for one in senders}
        self.loop: asyncio.AbstractEventLoop
        self._transport: Any  # an asyncio.DatagramTransport, which is typed without its buffer
        self._known: dict[str, Parameter] = {}  # by address; empty: not known
        self._waiting: set[asyncio.TimerHandle] = set()
        self.subscriptions: dict[tuple[str, int], _Subscription] = {}
        self._latest: Future[Any] | None = None  # of the changes
        self._second, self._answered = 0, 0  # errors of that second
        self._stop_listening: Callable[[], None] = lambda: None

    @property
    def url(self) -> str:
        """URL of the OSC server."""
        return f"osc.udp://{self.address}"

    async def start(self, loop: asyncio.AbstractEventLoop) -> None:
        """Begins to listen. Raises UsageError where the port is taken."""
        self.loop = loop
        port = self.address.port or free_port(self.address, "--osc")  # OSCQuery listens there, too
        try:
            self._transport, _ = await loop.create_datagram_endpoint(lambda: self, local_addr=(self.address.ip, port))
        except OSError as error:
            raise UsageError(
                f"--osc: {self.address} cannot be listened to: {os.strerror(error.errno or 0)}; name another address, "
                "or a port that is free, with --osc-at HOST:PORT"
            ) from error
        self.address = self.address._replace(port=self._transport.get_extra_info("sockname")[1])
        self._stop_listening = self.hub.listen(self._receive)

    async def close(self) -> None:
        """Ends that."""
        self._stop_listening()
        for timer in self._waiting:
            timer.cancel()
        for one in [*self.subscriptions.values()]:
            one.end()
        self._transport.close()
        if self.refused:
            self.report(f"OSC: {self.refused} packets or messages were refused; /hapsim/error told their senders why")

    def datagram_received(self, data: bytes, addr: tuple[Any, ...]) -> None:
        """Takes a packet."""
        if not self.takes_from(str(addr[0])):
            return
        try:
            messages = messages_of(data)
        except UsageError as error:
            self._refuse(str(error), addr)
            return
        if any(message.address == STOP for message in messages):  # at once, whatever a button adds
            self.hub.stop()
        others = (message for message in messages if message.address != STOP)
        for due, group in itertools.groupby(others, lambda message: message.due):
            self._make_at(due, [*group], addr)

    def takes_from(self, address: str) -> bool:
        """Returns whether packets from this sender are accepted."""
        ip = ip_of(address)
        return ip in self._senders if self._senders else bool(ip.is_loopback)

    def _make_at(self, due: float, messages: Sequence[Received], sender: tuple[Any, ...]) -> None:
        """Makes messages at their time. `due`: Unix time in s; what is over is made now."""
        wait = due - time.time()
        if wait <= 0:
            self._make(messages, sender)
        elif wait > _FURTHEST_S:
            self._refuse(f"found a time tag {wait:.4g} s ahead, expected at most {_FURTHEST_S:g} s", sender)
        elif len(self._waiting) >= _MOST_WAITING:
            self._refuse(f"more than {_MOST_WAITING} bundles wait for their time already: send fewer", sender)
        else:

            def make() -> None:
                self._waiting.discard(timer)
                self._make(messages, sender)

            timer = self.loop.call_later(wait, make)
            self._waiting.add(timer)

    def _make(self, messages: Sequence[Received], sender: tuple[Any, ...]) -> None:
        """Does what messages ask for, in their order; sets in a row with the same ramp are one change."""
        values: dict[str, Any] = {}
        over, asked = _OVER_S, dict[str, None]()
        for message in messages:
            try:
                found = self._named(message.address)
                if found is None or not message.arguments:
                    self._set(values, over, sender)
                    values = {}
                    asked |= dict.fromkeys(found or ())
                    if found is None:
                        self._command(message, sender)
                    continue
                new = {one.name: _value(one, message) for one in found.values()}
                ramp = next(iter(new.values()))[1]
                if ramp != over:
                    self._set(values, over, sender)
                    values, over = {}, ramp
                values |= {name: value for name, (value, _) in new.items()}
            except HapsimError as error:
                self._refuse(str(error), sender)
        self._set(values, over, sender)
        if asked and self._latest is not None:  # after the latest change
            self._when_done(self._latest, lambda _: self._answer([*asked], sender))
        elif asked:
            self._answer([*asked], sender)

    def _named(self, address: str) -> dict[str, Parameter] | None:
        """Returns the parameters that an address or a pattern names; None for a command. Raises UsageError."""
        if address in _COMMANDS:
            return None
        known = self._known = self._known or self.parameters()
        found = {one: known[one] for one in known if matches(address, one)} if is_pattern(address) else {}
        if not found and address not in known:
            raise UsageError(f"{shown(address)}: {self.why_unknown()}")
        return found or {address: known[address]}

    def why_unknown(self) -> str:
        """Returns why an address is not known, in words that follow it."""
        if self.hub.session is None:
            return "the device is not armed yet; once it is, this address may be known"
        commands = ", ".join(sorted((*_COMMANDS, STOP)))
        return f"no such address, expected {ROOT}PART/FIELD of a live parameter, or {commands}"

    def parameters(self) -> dict[str, Parameter]:
        """Returns the parameters that have an address, by that."""
        found = self.hub.parameters.items()
        return {ROOT + name.replace(".", "/"): one for name, one in found if one.kind != "points"}

    def _set(self, values: dict[str, Any], over: float, sender: tuple[Any, ...]) -> None:
        if values:
            self._latest = self.hub.set(values, over)
            self._refuse_with(self._latest, sender)

    def _refuse_with(self, change: Future[Any], sender: tuple[Any, ...]) -> None:
        """Has the sender get the reason if a change is refused."""
        self._when_done(change, lambda why: self._refuse(str(why), sender) if why else None)

    def _when_done(self, change: Future[Any], then: Callable[[BaseException | None], None]) -> None:
        """Calls `then`, in the view's thread, once a change is made or refused, with the reason of that."""

        def done(change: Future[Any]) -> None:
            with contextlib.suppress(RuntimeError):  # the server has ended
                self.loop.call_soon_threadsafe(then, change.exception())

        change.add_done_callback(done)

    def _answer(self, asked: Sequence[str], sender: tuple[Any, ...]) -> None:
        """Sends the values of these addresses."""
        known = self.parameters()
        packets = [packet_of(one, arguments_of(known[one].value)) for one in asked if one in known]
        for packet in packets if len(packets) == 1 else bundles_of(packets):
            self._send(packet, sender)

    def _command(self, message: Received, sender: tuple[Any, ...]) -> None:
        """Raises HapsimError."""
        if message.address in (TRIAL, PULSE):
            begin = self._begin_trial if message.address == TRIAL else self._begin_pulse
            begin(message.arguments, sender)
            return
        kinds, expected = _COMMANDS[message.address]
        arguments = message.arguments
        if len(arguments) > len(kinds) or not all(map(isinstance, arguments, kinds)) or not arguments:
            raise UsageError(f"{message.address}: found {_listed(arguments)}, expected {expected}")
        match arguments:
            case [int() | float() as seconds] if message.address == LEASE:
                self._refuse_with(self.hub.lease(float(seconds), None, tuple(sender[:2])), sender)
            case [str(text)]:
                if len(text) > _LONGEST_MARKER:
                    raise UsageError(f"{message.address}: found a longer text, expected {expected}")
                self.hub.mark(text)
            case [int() | float() as port, *rate]:  # Pd and Max have no other numbers than floats
                self._subscribe(sender, port, float(rate[0]) if rate else _RATE)

    def _begin_trial(self, arguments: Sequence[Argument], sender: tuple[Any, ...]) -> None:
        """Begins a trial: its number, then names, each with a value: live paths, `code`, `restart`, `over`."""
        number, *others = arguments or (0,)
        names = others[::2]
        if len(others) % 2 or not all(isinstance(one, str) for one in names) or isinstance(number, str) or number % 1:
            raise UsageError(f"{TRIAL}: found {_listed(arguments)}, expected {_COMMANDS[TRIAL][1]}")
        values: dict[str, Any] = dict(zip(map(str, names), others[1::2], strict=True))
        restart, code = str(values.pop("restart", "")).split(), values.pop("code", None)
        code = int(code) if isinstance(code, float) and code.is_integer() else code
        over = values.pop("over", _OVER_S)
        self._begin(lambda session: session.trial(int(number), values, restart, code, over), sender)

    def _begin_pulse(self, arguments: Sequence[Argument], sender: tuple[Any, ...]) -> None:
        match arguments:
            case [int() | float() as channel, str(shape), int() | float() as force, int() | float() as seconds, *rest]:
                if float(channel).is_integer() and len(rest) < 2 and not any(isinstance(one, str) for one in rest):
                    number, periods = int(channel), float(rest[0]) if rest else None
                    self._begin(lambda session: session.pulse(number, shape, force, seconds, periods), sender)
                    return
        raise UsageError(f"{PULSE}: found {_listed(arguments)}, expected {_COMMANDS[PULSE][1]}")

    def _begin(self, work: Callable[[Session], Any], sender: tuple[Any, ...]) -> None:
        """Does this after the changes before it; the sender gets the reason if it is refused."""
        self._latest = self.hub.in_turn(work)
        self._refuse_with(self._latest, sender)

    def _subscribe(self, sender: tuple[Any, ...], number: float, rate: float) -> None:
        port = int(number)
        if port != number or not 0 < port < 65536 or not (rate == 0 or 0.01 <= rate <= _HIGHEST_RATE):
            expected = f"a port and at most {_HIGHEST_RATE:g} Hz, or 0 to end"
            raise UsageError(f"{ROOT}subscribe: found {number:g} and {rate:g}, expected {expected}")
        key = (str(sender[0]), port)
        if key in self.subscriptions:
            self.subscriptions[key].end()
        if rate and len(self.subscriptions) >= _MOST_SUBSCRIPTIONS:
            raise UsageError(f"{ROOT}subscribe: found {_MOST_SUBSCRIPTIONS} subscriptions already, expected fewer")
        if rate:
            self.subscriptions[key] = _Subscription(self, (sender[0], port, *sender[2:]), rate, key)

    def _refuse(self, sentence: str, sender: tuple[Any, ...]) -> None:
        self.refused += 1
        second = int(self.loop.time())
        if second != self._second:
            self._second, self._answered = second, 0
        if self._answered < _MOST_ERRORS:
            self._answered += 1
            self._send(packet_of(f"{ROOT}error", [sentence]), sender)

    def _send(self, packet: bytes, receiver: tuple[Any, ...]) -> None:
        if not self._transport.is_closing() and self._transport.get_write_buffer_size() < _MOST_UNSENT:
            self._transport.sendto(packet, receiver)

    def _receive(self, event: Event) -> None:
        if event.kind == "armed" or (event.kind == "changed" and not event.values):
            self._known = {}  # there may be others
        if event.kind in ("place", "trial"):
            packets = [packet_of(ROOT + name.replace(".", "/"), [at]) for name, at in event.values.items()]
            if event.kind == "trial":
                packets = [packet_of(TRIAL, [*event.values.values(), event.sample])]
            with contextlib.suppress(RuntimeError):  # the server has ended
                self.loop.call_soon_threadsafe(self._send_to_all, packets)

    def _send_to_all(self, packets: Sequence[bytes]) -> None:
        for one in [*self.subscriptions.values()]:
            one.send(packets)


class _Subscription:
    """Sends the state to a program, until `end`. Its socket is connected, so that it learns when nobody listens."""

    def __init__(self, view: OscView, receiver: tuple[Any, ...], rate: float, key: tuple[str, int]) -> None:
        self._view, self._rate, self._key, self.loop = view, rate, key, view.loop
        family = socket.AF_INET6 if ":" in receiver[0] else socket.AF_INET
        self._socket = socket.socket(family, socket.SOCK_DGRAM)
        self._socket.setblocking(False)
        try:
            self._socket.connect(receiver)
        except OSError as error:
            self._socket.close()
            raise UsageError(f"{ROOT}subscribe: {error.strerror}; expected a port that can be reached") from None
        self._due = self.loop.time()
        self._timer = self.loop.call_soon(self._send)

    def end(self) -> None:
        """Ends it."""
        self._timer.cancel()
        self._socket.close()
        self._view.subscriptions.pop(self._key, None)

    def _send(self) -> None:
        self._due = max(self._due + 1.0 / self._rate, self.loop.time())
        self._timer = self.loop.call_at(self._due, self._send)
        self.send([packet_of(address, values) for address, values, *_ in read_only_values(self._view.hub)])

    def send(self, messages: Sequence[bytes]) -> None:
        """Sends messages, in bundles."""
        try:
            for bundle in bundles_of(messages):
                self._socket.send(bundle)
        except ConnectionRefusedError:
            self.end()
        except OSError:  # the network is full or away: the next may arrive
            pass


def read_only_values(hub: Hub) -> Iterator[tuple[str, list[Argument], list[str], str]]:
    """Yields address, values, their units and description of what OSC streams; nothing while nothing runs."""
    state = hub.state()
    if state is None:
        return

    def units(of_lines: str) -> list[str]:
        return [hub.scene.units_of(channel).si.name(of_lines) for channel in range(len(state.position))]

    yield f"{ROOT}position", [*map(float, state.position)], units("m"), "Position of each channel"
    yield f"{ROOT}velocity", [*map(float, state.velocity)], units("m/s"), "Velocity of each channel"
    yield f"{ROOT}force", [*map(float, state.force)], units("N"), "Force on each channel"
    for name, place in state.places.items():
        yield f"{ROOT}{name}/place", [place], [""], "Number of the place that the detent is in"
    for name, value in state.progress.words.items():
        part, _, key = name.partition(".")
        if part == "inputs" or not hub.scene.outputs[key].is_set_by_programs:  # the others are parameters
            what = "1 while the input is on" if part == "inputs" else "Value of the output"
            yield f"{ROOT}{part}/{key}", [value], [""], what
    yield f"{ROOT}ticks", [state.sample], ["samples"], "The device's count of samples"


_COMMANDS: dict[str, tuple[tuple[Any, ...], str]] = {
    f"{ROOT}subscribe": ((int | float, int | float), "PORT and RATE in Hz"),
    LEASE: ((int | float,), "SECONDS until it is sent again, 0.005 to 3600, or 0 to end the lease"),
    f"{ROOT}marker": ((str,), f"one text of at most {_LONGEST_MARKER} characters"),
    PULSE: ((), "CHANNEL, SHAPE, FORCE in N or N·m, SECONDS, and the PERIODS of a buzz"),
    TRIAL: ((), "NUMBER, then NAME VALUE for each live value (touch.stiffness 500), code, restart or over"),
}
"""Addresses that are no parameters: the types of their arguments, of which the first is needed, and that in words."""


def _value(parameter: Parameter, message: Received) -> tuple[Any, float]:
    """Returns the value that a message means for a parameter, and the ramp in s. Raises UsageError."""
    count = len(parameter.value) if parameter.kind == "numbers" and isinstance(parameter.value, tuple) else 1
    values, ramp = message.arguments[:count], message.arguments[count:]
    kind = str if parameter.kind == "word" else (int, float)
    fits = len(values) == count and len(ramp) < 2 and all(isinstance(one, kind) for one in values)
    if not fits or any(isinstance(one, str) for one in ramp):
        expected = "a word" if parameter.kind == "word" else "a number" if count == 1 else f"{count} numbers"
        raise UsageError(
            f"{shown(message.address)}: found {_listed(message.arguments)}, expected {expected}, "
            "and the seconds of a ramp or nothing"
        )
    plain = [one if isinstance(one, str) else float(one) for one in values]
    return plain if parameter.kind == "numbers" else plain[0], float(ramp[0]) if ramp else _OVER_S


def arguments_of(value: Any) -> list[Argument]:
    """Returns a parameter's value as OSC has it."""
    values = value if isinstance(value, tuple) else (value,)
    return [one if isinstance(one, str) else float(one) for one in values]


def _listed(arguments: Sequence[Argument]) -> str:
    return shown(" ".join(map(str, arguments))) or "no arguments"
