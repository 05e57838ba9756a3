"""The state of a loop as a document, for a record that begins during a run, and back into a loop that replays it.

The document has the bytes of everything that a tick changes: the loop's records, those of the correction, and the
memory of the program, during a crossfade of both. A replay assembles the loop of the same scenes anew and overwrites
these bytes. Addresses differ there. One that points into the state is stored as the number of a block and a place in
it. Any other, such as that of a function, stays that of the new loop. A hash of all types and shapes tells whether the
bytes fit.
"""

from __future__ import annotations

import base64
import ctypes
import hashlib
import zlib
from bisect import bisect_right
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from firmware_protocol.compiled import new_record
from hapsim.compiling.native import address_of
from hapsim.cordis.dispatch import CALLS
from hapsim.cordis.parameters import move
from hapsim.cordis.program import Program, compile_scene
from hapsim.loop.crossfade import cross_fade
from hapsim.loop.exchange import LOOP
from hapsim.loop.hooks import HOOKS, Hook, Stage, set_hooks
from hapsim.loop.posted import Mailbox
from hapsim.loop.snapshot import SNAPSHOT, copy_state
from hapsim.prediction.correction import rendered
from hapsim.running.assemble_loop import LoopMemory
from hapsim.scene import Scene
from hapsim.scene.load import document_of

_NO_STATE = ("inbox", "framing", "ring", "sound", "control", "posted", "histograms")
"""Fields of LOOP that belong to the wire, to readers of the loop, or to its end."""
_OTHER, _INSIDE, _BLOCK = 1, 1 << 63, 40  # an address out of the state; one in it, with its block from this bit on


@dataclass(frozen=True)
class RecordedState:
    """The state of a loop in a tick, once its position is read, in a record."""

    layout: str
    """A hash."""
    tables: int
    """Number of the correction's."""
    bytes: str
    """Compressed, in base 64."""
    first_scene: dict[str, Any]
    """The scene of the run's beginning."""
    older_scene: dict[str, Any] | None = None
    """The one before a crossfade that is under way."""


class Snapshot(NamedTuple):
    """The state of a loop in a tick, and its place in the run."""

    tick: int
    sample: int
    """Number of the position, counted from arming."""
    scenes: list[Scene]
    """The scene that the loop moves, during a crossfade behind the one before it."""
    state: dict[str, Any]
    """Document of `RecordedState`."""


def take_snapshot(loop: LoopMemory, mailbox: Mailbox, scenes: Sequence[Scene]) -> Snapshot | None:
    """Returns the state of a running loop in one of its next ticks; None if the loop has ended. No change may be posted
    meanwhile. `scenes`: the present one, behind the one before the last crossfade."""
    programs = loop.moved_programs
    blocks = _memory(loop, programs)
    copies = [np.array(block) for block in blocks]  # written here first, so that the loop causes no page fault
    own, listed = new_record(SNAPSHOT), new_record(HOOKS)
    places = np.array([(address_of(a), address_of(b), a.nbytes) for a, b in zip(blocks, copies, strict=True)], np.int64)
    own.blocks, own.count = address_of(places), len(places)
    lists = set_hooks(listed, [Hook(Stage.READ, copy_state, own), *loop.hooks])
    calls = loop.record.hooks.before_scene
    for pairs, count in (listed.before_scene.item(), calls.item()):
        mailbox.add(calls, "pairs", pairs)
        mailbox.add(calls, "count", count)
        mailbox.send()
        mailbox.wait()
    del lists
    if not own.taken:
        return None
    for block, copy in zip(blocks, copies, strict=True):
        if block.dtype.names:
            _encode_addresses(copy, blocks)
    data = zlib.compress(b"".join(copy.tobytes() for copy in copies), 1)
    moved = [*scenes[-len(programs) :]]
    state: dict[str, Any] = {
        "layout": _layout(blocks),
        "tables": len(loop.correction.tables) if loop.correction else 0,
        "bytes": base64.b64encode(data).decode(),
        "first_scene": document_of(loop.setting.scene),
        "older_scene": document_of(moved[0]) if len(moved) > 1 else None,
    }
    return Snapshot(int(own.tick), int(own.sample), moved, state)


def restore(loop: LoopMemory, state: RecordedState, scenes: Sequence[Scene]) -> bool:
    """Puts a loop, newly assembled for the scene of the run's beginning, into a recorded state. Returns False if that
    has another layout, of another version. `scenes`: the one that the loop moved, during a crossfade behind the one
    before it. Raises ValueError where the state is damaged."""
    programs = []
    for scene in scenes:
        rendering = rendered(scene)
        programs.append(compile_scene(rendering.scene))
        programs[-1].call_all_of("place")
        programs[-1].parameters.record.move = move.address()
        loop.account_for(programs[-1], rendering.scene)
        loop.rendered_scene = rendering.scene
    loop.set_programs(*programs)
    loop.record.slot.cross_fade = cross_fade.address()
    if loop.correction is not None:
        loop.correction.make_tables(state.tables)
    blocks = _memory(loop, programs)
    if state.layout != _layout(blocks):
        return False
    try:
        data, at = zlib.decompress(base64.b64decode(state.bytes)), 0
    except zlib.error as error:
        raise ValueError(str(error)) from None
    for block in blocks:
        saved = np.frombuffer(data, block.dtype, block.size, at).reshape(block.shape).copy()
        at += block.nbytes
        if block.dtype.names:
            _decode_addresses(saved, block, blocks)
        if block.flags.writeable:
            block[...] = saved
    return True


def _memory(loop: LoopMemory, programs: Sequence[Program]) -> list[NDArray[Any]]:
    """Returns all arrays with the loop's state, in an order that only the scene determines."""
    record, found = loop.record, list[NDArray[Any]]()
    roots = (
        [record[name] for name in LOOP.names or () if name not in _NO_STATE],
        [record.sound.last, record.sound.passed],
        [one.kept for one in loop.hooks],
        loop.correction.memory if loop.correction else (),
        [program.memory for program in programs],
    )
    spans: list[tuple[int, int]] = []
    for array in _arrays(roots):
        begin, end = address_of(array), address_of(array) + array.nbytes
        if begin < end and not any(low <= begin and end <= high for low, high in spans):
            spans.append((begin, end))
            found.append(array)
    return found


def _arrays(value: Any) -> Iterator[NDArray[Any]]:
    """Yields the arrays and records in a nested value."""
    if isinstance(value, np.ndarray):
        if not value.flags.c_contiguous:
            raise TypeError("an array of the state has to be contiguous")
        yield value
    elif isinstance(value, np.void):
        own = (ctypes.c_uint8 * value.nbytes).from_address(address_of(value))  # numpy's view of it is read-only
        yield np.frombuffer(memoryview(own), value.dtype)
    elif isinstance(value, Mapping):
        yield from _arrays(tuple(value.values()))
    elif isinstance(value, tuple | list):
        for one in value:
            yield from _arrays(one)


def _layout(blocks: Sequence[NDArray[Any]]) -> str:
    """Returns a hash of the types and shapes of all blocks."""
    return hashlib.sha256(repr([(str(one.dtype), one.shape) for one in blocks]).encode()).hexdigest()


def _addresses(of: np.dtype[Any], at: int = 0) -> Iterator[int]:
    """Yields where words of a record are addresses, or belong to one: the lengths of lists of calls."""
    if of.subdtype is not None:
        for i in range(int(np.prod(of.shape))):
            yield from _addresses(of.base, at + i * of.base.itemsize)
    elif of == CALLS:
        yield from (at, at + 8)
    elif of.fields is not None:
        for inner, offset, *_ in of.fields.values():
            yield from _addresses(inner, at + offset)
    elif of == np.uint64:
        yield at


def _words(records: NDArray[Any]) -> tuple[NDArray[np.uint64], list[int]]:
    """Returns records as words, and the numbers of those that are addresses."""
    of = records.dtype
    each = [at // 8 for at in _addresses(of)]
    words = records.reshape(-1).view(np.uint8).view(np.uint64)
    return words, [i * of.itemsize // 8 + at for i in range(records.size) for at in each]


def _encode_addresses(records: NDArray[Any], blocks: Sequence[NDArray[Any]]) -> None:
    """Replaces each address in records by its block and its place there, or by `_OTHER`; 0 stays."""
    begins = sorted((address_of(block), block.nbytes, number) for number, block in enumerate(blocks))
    words, places = _words(records)
    for i in places:
        address = int(words[i])
        begin, size, number = begins[max(bisect_right(begins, (address, 1 << 62, 0)) - 1, 0)]
        if address:
            words[i] = _INSIDE | number << _BLOCK | address - begin if begin <= address < begin + size else _OTHER


def _decode_addresses(saved: NDArray[Any], records: NDArray[Any], blocks: Sequence[NDArray[Any]]) -> None:
    """Replaces what `_encode_addresses` wrote by the addresses of this process: those in `records` where they are
    `_OTHER`."""
    (words, places), (present, _) = _words(saved), _words(records)
    for i in places:
        code = int(words[i])
        if code & _INSIDE:
            block, offset = divmod(code - _INSIDE, 1 << _BLOCK)
            if block >= len(blocks) or offset >= blocks[block].nbytes:
                raise ValueError("found an address out of the state")
            words[i] = address_of(blocks[block]) + offset
        elif code:
            words[i] = present[i]
