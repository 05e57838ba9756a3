"""A script of faults, and what it does: bytes in, bytes out with its faults in them, and when.

A script says in YAML which faults happen when; its errors have file, line and column, as those of scenes have. The
injector applies it without a port and without a clock: the same bytes at the same times make the same faults. A carrier
brings the bytes and the time, in seconds from any beginning, and asks `next_s` when to call again although nothing
comes.
"""

from __future__ import annotations

import math
import os
import re
from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from typing import Annotated, Any, NamedTuple, Union

from pydantic import Field, ValidationError, create_model

from firmware_protocol import schema
from firmware_protocol.capture import Capture, Decoded
from hapsim.bringup.faults.fault import KINDS, Fault, Moment, Piece, tidy
from hapsim.bringup.faults.witness import Witness
from hapsim.errors import UsageError
from hapsim.scene.quantity import count, version
from hapsim.scene.schemas import FROM_FILE
from hapsim.scene.section import Section
from hapsim.scene.yaml_file import Layout, YamlFile, findings_of


class Script(Section):
    """Faults on the wire. They act on every frame one after the other, in the order of the script.

    Attributes:
        version: version of the format, 1.
        seed: seed of everything random. The same seed and the same bytes make the same faults.
        faults: the faults, in the order of the file.
    """

    version: Annotated[int, version(1, "script")]
    seed: Annotated[int, count("Seed of everything random", 0, 2**32 - 1)] = 0
    faults: list[Fault] = Field(min_length=1)


_FILE = YamlFile(UsageError, "a script of faults in YAML", "found nothing, expected a script: version and faults")
_LAYOUT = Layout(
    Script,
    "faults",
    "kind",
    KINDS,
    "a mapping such as {kind: drop, probability: 0.001}",
    {(): "a mapping with version and faults", ("faults",): "a list of faults, at least one"},
)


def load_script(path: str | os.PathLike[str]) -> Script:
    """Returns the script of a file. Raises UsageError with one line for each error in it."""
    return parse_script(_FILE.text_of(path), os.fsdecode(path))


@cache
def _model(kinds: tuple[type[Fault], ...]) -> type[Script]:
    """Returns the model of a script whose faults are of any of these kinds."""
    one: Any = Annotated[Union[kinds], Field(discriminator="kind")]  # noqa: UP007
    return create_model("Script", __base__=Script, faults=(list[one], Field(min_length=1)))


def parse_script(text: str, name: str = "<script>") -> Script:
    """Returns the script of a text in YAML that errors call `name`. Raises UsageError with one line for each error."""
    document = _FILE.document_of(text, name)
    script, issues = None, []
    try:
        script = _model(tuple(KINDS.values())).model_validate(document.data, context=FROM_FILE)
    except ValidationError as error:
        issues = findings_of(error, document, _LAYOUT)
    located = _FILE.located(issues, document)
    if script is None or located:
        raise _FILE.failure(name, located)
    return script


_PIECE = re.compile(rb"[^\0]{0,511}\0|[^\0]{512}")
"""Bytes up to a delimiter. 512 without one, far more than a frame has, pass as they are."""


class Passed(NamedTuple):
    """Bytes that leave."""

    due_s: float
    """Time to send it, by the carrier's clock; never before an earlier piece in the same direction."""
    to_device: bool
    data: bytes


@dataclass
class Traffic:
    """Traffic in one direction. A damaged frame does not count as a frame."""

    frames_in: int = 0
    bytes_in: int = 0
    frames_out: int = 0
    bytes_out: int = 0


class Happened(NamedTuple):
    """A fault of the script, and how often it happened."""

    place: int
    """Position in the script, from 1."""
    kind: str
    when: str
    """Start of the fault, in words."""
    times: int
    counted: str
    """Unit of `times`, in words."""


class Splitter:
    """Cuts the bytes of one direction into pieces, however they arrive: the same bytes make the same pieces."""

    def __init__(self, to_device: bool) -> None:
        self._capture = Capture((to_device,))
        self._to_device = to_device
        self._waiting = b""

    def split(self, data: bytes) -> Iterator[Piece]:
        """Yields every piece that ends in `data`. The rest waits for its delimiter."""
        waiting, end = self._waiting + data, 0
        for match in _PIECE.finditer(waiting):
            piece, end = match[0], match.end()
            last = deque(self._capture.feed(piece), maxlen=1)
            frames = [one for one in last if isinstance(one, Decoded) and len(one.data) < len(piece)]
            yield Piece(piece, self._to_device, frames[0] if frames else None)
        self._waiting = waiting[end:]


class Injector:
    """The faults of a script, between a host and a device."""

    def __init__(self, script: Script, seed: int | None = None) -> None:
        """`seed` replaces the script's."""
        seed = script.seed if seed is None else seed
        self._faults = [fault.at_work(f"{seed} {at} {fault.kind}") for at, fault in enumerate(script.faults)]
        self._splitters = {to_device: Splitter(to_device) for to_device in (False, True)}
        self._latest_s = {False: -math.inf, True: -math.inf}
        self._begun_s: float | None = None
        self._number = -1
        self._under_way: deque[tuple[Piece, float]] = deque()
        self.samples = -1
        """Samples of the device since its first position; -1 before that."""
        self.first_fault_s: float | None = None
        """Time of the first fault by the carrier's clock; None before it."""
        self.witness = Witness()
        """Record of the frames on the device's side of the faults."""
        self.passed = {to_device: Traffic() for to_device in (False, True)}
        """Traffic in each direction, before and after the faults."""
        self.plugged = True
        """True if the host sees the device as plugged in."""

    @property
    def counts(self) -> list[tuple[str, int]]:
        """Each fault of the script, and how often it happened."""
        return [(fault.kind, fault.count) for fault in self._faults]

    @property
    def happened(self) -> list[Happened]:
        """The same, with the place of each in the script, when it begins, and what is counted."""
        return [
            Happened(place, fault.kind, fault.when(), fault.count, fault.counted)
            for place, fault in enumerate(self._faults, start=1)
        ]

    def take(self, data: bytes, to_device: bool, time_s: float) -> list[Passed]:
        """Returns what leaves when bytes come in, and what time brings; in the order in which it leaves."""
        if self._begun_s is None:
            self._begun_s = time_s
        passed = self.advance(time_s)
        self.passed[to_device].bytes_in += len(data)
        for piece in self._splitters[to_device].split(data):
            self.passed[to_device].frames_in += piece.found is not None
            if not to_device:
                self._count_samples(piece)
                self.witness.receive(piece, time_s, self.samples)
            passed += self.advance(time_s)
            passed += self._through([piece], 0, time_s)
        self._arrive(time_s)
        return passed

    def advance(self, time_s: float) -> list[Passed]:
        """Returns what leaves although nothing comes in."""
        if self._begun_s is None:
            return []
        self._arrive(time_s)
        now, passed = self._moment(time_s), list[Passed]()
        for at, fault in enumerate(self._faults):
            before = fault.count
            passed += self._through(fault.pass_time(now), at + 1, time_s)
            if fault.plugs is not None and fault.count > before:
                self.plugged = fault.plugs
        self._note_first(time_s)
        return passed

    def next_s(self, time_s: float) -> float:
        """Returns when to call `advance` although nothing comes in, by the carrier's clock; infinity if never."""
        if self._begun_s is None:
            return math.inf
        now = self._moment(time_s)
        return self._begun_s + min((fault.next_s(now) for fault in self._faults), default=math.inf)

    def _moment(self, time_s: float) -> Moment:
        return Moment(tidy(time_s - (self._begun_s or 0.0)), self.samples)

    def _through(self, pieces: list[Piece], first: int, time_s: float) -> list[Passed]:
        """Passes pieces through the faults from `first` on."""
        if not pieces:
            return []
        now = self._moment(time_s)
        for fault in self._faults[first:]:
            pieces = [after for before in pieces for after in fault.take(before, now)]
        self._note_first(time_s)
        return [self._leave(piece, time_s) for piece in pieces if self.plugged and piece.data]

    def _leave(self, piece: Piece, time_s: float) -> Passed:
        due_s = max(time_s + piece.delay_s, self._latest_s[piece.to_device])
        self._latest_s[piece.to_device] = due_s
        traffic = self.passed[piece.to_device]
        traffic.frames_out += piece.found is not None
        traffic.bytes_out += len(piece.data)
        if piece.to_device and piece.found is not None:
            self._under_way.append((piece, due_s))
        return Passed(due_s, piece.to_device, piece.data)

    def _arrive(self, time_s: float) -> None:
        """Shows the witness what has reached the device by now."""
        while self._under_way and self._under_way[0][1] <= time_s:
            self.witness.see(*self._under_way.popleft(), self.samples)

    def _note_first(self, time_s: float) -> None:
        if self.first_fault_s is None and any(fault.count for fault in self._faults):
            self.first_fault_s = self.witness.fault_s = time_s

    def _count_samples(self, piece: Piece) -> None:
        """Counts as the device does, over every arming."""
        frame = piece.frame
        if piece.is_from_device(schema.STATUS):
            self._number = -1
        elif frame is not None and frame.type in schema.POSITIONS:
            gap = (frame.number - self._number) % schema.SAMPLE_MODULUS
            if gap < schema.SAMPLE_MODULUS // 2:  # else it is one of the past
                self.samples += gap
                self._number = frame.number
