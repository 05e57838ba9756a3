"""`hapsim frames`: what is on the wire, read by people."""

from __future__ import annotations

import contextlib
import os
import select
import stat
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from hapsim.cli.arguments import Json, complain, seconds_above_zero, stderr
from hapsim.cli.sentences import say
from hapsim.errors import DeviceError, UsageError

if TYPE_CHECKING:
    from hapsim.bringup.capture import Capture, Decoded, Refused
    from hapsim.cli.frames_table import JsonDocument

_SENDERS = {"host": (True,), "device": (False,), "both": (True, False)}
_PIECE = 1 << 16
_LONG = 1 << 22  # bytes: of a longer file it says how far it is
_LOOK_S = 0.2  # how often a silent port or pipe is left to see whether it is enough

Piece = tuple[bytes, float | None]


def frames(
    source: Annotated[
        str,
        typer.Argument(
            metavar="FILE|PORT", help="A capture, raw bytes, or a report file; - for standard input; or a serial port."
        ),
    ],
    sender: Annotated[
        str, typer.Option("--from", metavar="WHO", help="Whose frames to look for: host, device or both.")
    ] = "both",
    hex_too: Annotated[bool, typer.Option("--hex", help="Show the bytes of every frame too.")] = False,
    baud: Annotated[int, typer.Option(min=1, max=100_000_000, help="Of a port, bit/s.")] = 2_000_000,
    duration: Annotated[
        float | None,
        typer.Option(metavar="S", callback=seconds_above_zero, help="Listen to a port for so long; else until Ctrl-C."),
    ] = None,
    json: Json = False,
) -> None:
    """Decode a capture of the wire or the frames of a report file, or listen at a port without sending: every frame
    field by field, and what is refused."""
    if sender not in _SENDERS:
        raise UsageError(f"--from: found '{sender}', expected host, device or both")
    from hapsim.bringup.capture import Capture
    from hapsim.cli.frames_table import JsonDocument, counters_of
    from hapsim.running.signals import stopping_on_signals

    document = JsonDocument(sys.stdout.write, source) if json else None
    stopped: list[bool] = []
    show = _Shown(sender, hex_too, document)
    failure: DeviceError | None = None
    with stopping_on_signals(lambda: stopped.append(True)):
        if _is_report(source):
            _show_report(Path(source), show)
        else:
            with _pieces_of(source, baud, duration, lambda: bool(stopped)) as pieces:
                failure = show.all_of(Capture(_SENDERS[sender]), pieces)
    if document is not None:
        error = {} if failure is None else {"error": str(failure), "exit_status": failure.exit_status}
        document.close({"counters": counters_of(show.captures), "stopped": bool(stopped)} | show.beside | error)
    if failure is not None:
        complain(failure)  # its document is written
        raise typer.Exit(failure.exit_status)


class _Shown:
    """What is found, as text or in a document."""

    def __init__(self, sender: str, hex_too: bool, document: JsonDocument | None) -> None:
        self.sender, self.document = sender, document
        self.captures: list[Capture] = []
        self.beside: dict[str, Any] = {}
        """What a document tells beside the entries."""
        self._hex_too = hex_too

    def all_of(self, capture: Capture, pieces: Iterator[Piece]) -> DeviceError | None:
        """Shows every piece, and what they come to."""
        from hapsim.cli.frames_table import TEXT_INDENT, entry_of, summary_of, text_of

        self.captures.append(capture)

        def show(found: Decoded | Refused, time_s: float | None) -> None:
            entry = entry_of(capture, found, time_s, self._hex_too)
            if self.document is not None:
                self.document.add(entry)
            else:
                say(text_of(entry), indent=TEXT_INDENT)

        failure = _decode(capture, pieces, show)
        if self.document is None:
            say(summary_of(capture, self.sender))
        return failure


def _is_report(source: str) -> bool:
    from hapsim.recording.report_file import is_report

    path = Path(source)
    try:
        return path.is_file() and is_report(path)
    except OSError:
        return False  # whoever reads it says so


def _show_report(path: Path, show: _Shown) -> None:
    """One direction after the other: nothing tells when which byte was on the wire."""
    from hapsim.bringup.capture import Capture
    from hapsim.recording.report_file import read_report

    report = read_report(path)
    registers = {int(number): value for number, value in report.about["registers"].items()}
    show.beside = {"report": {name: report.about[name] for name in ("when", "port", "sentence")}}
    if show.document is None:
        say(f"{report.about['when']}  {report.about['sentence']}")
    for from_host, data in ((False, report.wire.from_device), (True, report.wire.to_device)):
        if from_host not in _SENDERS[show.sender]:
            continue
        if show.document is None:
            say("\nto the device:" if from_host else "\nfrom the device:")
        capture = Capture((from_host,))
        capture.registers.update(registers)
        show.all_of(capture, iter([(data, None)]))


def _decode(
    capture: Capture, pieces: Iterator[Piece], show: Callable[[Decoded | Refused, float | None], None]
) -> DeviceError | None:
    """Shows what there is to the end, which may be that the port went away: that is returned."""
    failure, time_s = None, None
    try:
        for data, time_s in pieces:
            for found in capture.feed(data):
                show(found, time_s)
            if time_s is not None:
                sys.stdout.flush()
    except DeviceError as error:
        failure = error
    for found in capture.finish():
        show(found, time_s)
    return failure


@contextlib.contextmanager
def _pieces_of(
    source: str, baud: int, duration: float | None, stopped: Callable[[], bool]
) -> Iterator[Iterator[Piece]]:
    """The bytes of a file, of standard input, or of a port, each with when it came, in s, where that is known.
    UsageError and DeviceError with what to do where there are none."""
    if source == "-":
        yield _of_stream("standard input", sys.stdin.buffer, stopped)
        return
    try:
        kind = Path(source).stat().st_mode
    except OSError as error:
        if sys.platform == "win32" and source.upper().startswith("COM"):
            kind = stat.S_IFCHR
        else:
            from hapsim.device.port_name import leads_to

            link = leads_to(source) if isinstance(error, FileNotFoundError) else None
            why = f"neither a file nor a port: {error.strerror}" if link is None else f"a link to {link}, which is gone"
            raise UsageError(f"{source}: {why}") from error
    if stat.S_ISCHR(kind):
        yield from _of_port(source, baud, duration, stopped)
    elif stat.S_ISDIR(kind):
        raise UsageError(f"{source}: found a directory, expected a capture (raw bytes) or a serial port")
    else:
        with _reading(source):
            stream = open(source, "rb")  # noqa: SIM115 - closed below: only a failed opening is reported as one
        with stream:
            yield _of_stream(source, stream, stopped)


@contextlib.contextmanager
def _reading(source: str) -> Iterator[None]:
    """Only around what reads: where the output cannot be written, the capture is not to blame."""
    try:
        yield
    except OSError as error:
        raise UsageError(f"{source}: cannot be read: {error.strerror}") from error


def _of_stream(name: str, stream: Any, stopped: Callable[[], bool]) -> Iterator[Piece]:
    from hapsim.cli.live import live_words

    descriptor = stream.fileno()
    status = os.fstat(descriptor)
    regular = stat.S_ISREG(status.st_mode)
    done = 0
    with live_words(stderr()) if regular and status.st_size > _LONG else contextlib.nullcontext() as say:
        while not stopped():
            if not regular and not select.select([descriptor], [], [], _LOOK_S)[0]:
                continue
            with _reading(name):
                data = os.read(descriptor, _PIECE)
            if not data:
                break
            done += len(data)
            if say is not None:
                say(f"decoding {name}: {done / status.st_size:.0%}")
            yield data, None
    if not done and not stopped():
        raise UsageError(f"{name}: found no bytes: the capture is empty")


def _of_port(path: str, baud: int, duration: float | None, stopped: Callable[[], bool]) -> Iterator[Iterator[Piece]]:
    import numpy as np

    from hapsim.device.serial_port import open_portable_port

    def listen() -> Iterator[Piece]:
        buffer, begun = np.zeros(_PIECE, np.uint8), time.monotonic()
        while not stopped() and (duration is None or time.monotonic() - begun < duration):
            count = connection.transport.receive(buffer, round(_LOOK_S * 1e9))
            if count < 0:
                raise DeviceError(f"{path}: the port is gone")
            if count:
                yield buffer[:count].tobytes(), time.monotonic() - begun

    with contextlib.closing(open_portable_port(path, baud)) as connection:
        yield listen()
