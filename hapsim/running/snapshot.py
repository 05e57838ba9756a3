"""The state of a loop in a record that begins during a run, and back into a loop that replays it.

It is the bytes of everything that a tick changes: the loop's records, those of the correction, and the memory of the
program, during a crossfade of both. A replay assembles the loop of the same scenes anew and overwrites these bytes.
Addresses differ there: one that points into the state points to the same place of the new one, and any other, such as
that of a function, stays that of the new loop.
"""

from __future__ import annotations

import base64
import ctypes
import hashlib
import zlib
from bisect import bisect_right
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hapsim.compiling.native import address_of
from hapsim.cordis.dispatch import CALLS
from hapsim.cordis.parameters import move
from hapsim.cordis.program import Program, compile_scene
from hapsim.loop.crossfade import cross_fade
from hapsim.loop.exchange import LOOP
from hapsim.loop.posted import Mailbox
from hapsim.prediction.correction import rendered
from hapsim.running.assemble_loop import LoopMemory
from hapsim.scene import Scene

_OTHERS = {"inbox", "framing", "ring", "sound", "control", "posted", "histograms"}  # wire, readers, end of a run
_STATES = [name for name in LOOP.names or () if name not in _OTHERS]
"""Fields of LOOP with the state of the scene."""

Block = NDArray[Any]


@dataclass(frozen=True)
class LoopState:
    """The state of a loop between two ticks."""

    tick: int
    """Number of ticks before."""
    sample: int
    """Number of the position before, counted from arming."""
    scenes: list[dict[str, Any]]
    """Documents of the scene that the run began with, of the one before if a crossfade is under way, and of the present
    one."""
    layout: str
    """Hash of the types and shapes of all blocks."""
    places: list[int]
    """Address of each block when it was copied."""
    tables: int
    """Number of the correction's tables."""
    blocks: str
    """All blocks, compressed, in base 64."""
    pulses: tuple[int, ...] = ()
    """Samples of each channel's newest pulse, if there was any."""
    lease: dict[str, Any] | None = None
    """State of the lease, as `Lease.restore` takes it; None: there was none so far."""


def take_state(
    loop: LoopMemory, mailbox: Mailbox, scenes: Sequence[Scene], lease: dict[str, Any] | None = None
) -> LoopState | None:
    """Returns the state of a running loop before one of its next ticks; None if it has ended. No change may be posted
    meanwhile. `scenes`: the one before the last crossfade, and the present one. `lease`: its state."""
    programs = loop.moved_programs
    blocks = _blocks(loop, programs)
    copies = mailbox.copies(blocks)
    if copies is None:
        return None
    state = copies[_STATES.index("state")][0]
    return LoopState(
        tick=int(state["ticks"]),
        sample=int(state["sample"]),
        scenes=[one.ranged_document for one in (loop.setting.scene, *scenes[-len(programs) :])],
        layout=_layout(blocks),
        places=[address_of(block) for block in blocks],
        tables=len(loop.correction.tables) if loop.correction else 0,
        pulses=loop.pulses.lengths,
        lease=lease,
        blocks=base64.b64encode(zlib.compress(b"".join(copy.tobytes() for copy in copies), 1)).decode(),
    )


def restore(loop: LoopMemory, state: LoopState, scenes: Sequence[Scene]) -> bool:
    """Puts a loop, newly assembled for the scene that the run began with, into a recorded state. Returns False if that
    is of another layout. `scenes`: of the state, without the first. Raises ValueError where the state is damaged."""
    programs = []
    for scene in scenes:
        loop.rendered_scene = rendered(scene).scene
        programs.append(compile_scene(loop.rendered_scene))
        programs[-1].call_all_of("place")
        programs[-1].parameters.record.move = move.address()
        loop.account_for(programs[-1], loop.rendered_scene)
    loop.set_programs(*programs)
    loop.record.slot.cross_fade = cross_fade.address()
    if loop.correction is not None:
        loop.correction.tables = [np.zeros_like(loop.correction.tables[0]) for _ in range(state.tables)]
    if state.pulses:
        loop.pulses.forces[:] = map(np.zeros, state.pulses)
        loop.add_pulse_hooks()
    blocks = _blocks(loop, programs)
    if state.layout != _layout(blocks) or len(state.places) != len(blocks):
        return False
    try:
        data, at = zlib.decompress(base64.b64decode(state.blocks)), 0
    except zlib.error as error:
        raise ValueError(str(error)) from None
    for block in blocks:
        saved = np.frombuffer(data, block.dtype, block.size, at).reshape(block.shape).copy()
        at += block.nbytes
        if block.dtype.names:
            _readdress(saved, block, state.places, blocks)
        if block.flags.writeable:
            block[...] = saved
    return True


def _readdress(saved: Block, present: Block, places: Sequence[int], blocks: Sequence[Block]) -> None:
    """Replaces addresses in recorded records: by those in the new `blocks`, or else by those that are `present`."""
    begins = sorted((place, block.nbytes, address_of(block)) for place, block in zip(places, blocks, strict=True))
    words, others = (one.reshape(-1).view(np.uint8).view(np.uint64) for one in (saved, present))
    each = [at // 8 for at in _addresses(saved.dtype)]
    for i in (n * saved.dtype.itemsize // 8 + at for n in range(saved.size) for at in each):
        word = int(words[i])
        begin, size, address = begins[max(bisect_right(begins, (word, 1 << 62, 0)) - 1, 0)]
        if word:
            words[i] = address + word - begin if begin <= word < begin + size else others[i]


def _addresses(of: np.dtype[Any], at: int = 0) -> Iterator[int]:
    """Yields where words of a record are addresses, or belong to one: the lengths of lists of calls."""
    if of.subdtype is not None:
        for i in range(int(np.prod(of.shape))):
            yield from _addresses(of.base, at + i * of.base.itemsize)
    elif of.fields is not None and of != CALLS:
        for inner, offset, *_ in of.fields.values():
            yield from _addresses(inner, at + offset)
    elif of in (CALLS, np.uint64):
        yield from range(at, at + of.itemsize, 8)


def _blocks(loop: LoopMemory, programs: Sequence[Program]) -> list[Block]:
    """Returns all arrays with the loop's state, in an order that only the scenes determine."""
    record, found = loop.record, list[Block]()
    records = [record[name] for name in _STATES]
    moved = programs if loop.fallback is None else [*programs, loop.fallback]
    correction = vars(loop.correction) if loop.correction else {}
    roots = (
        records,
        record.sound.last,
        record.sound.passed,
        loop.pulses.forces,
        loop.hooks,
        correction,
        [one.memory for one in moved],
    )
    spans: list[tuple[int, int]] = []
    for array in arrays_in(roots):
        begin, end = address_of(array), address_of(array) + array.nbytes
        if begin < end and not any(low <= begin and end <= high for low, high in spans):
            spans.append((begin, end))
            found.append(array)
    return found


def arrays_in(value: Any) -> Iterator[Block]:
    """Yields the arrays and records in a nested value."""
    if isinstance(value, np.ndarray):
        if not value.flags.c_contiguous:
            raise TypeError("an array of the state has to be contiguous")
        yield value
    elif isinstance(value, np.void):
        own = (ctypes.c_uint8 * value.nbytes).from_address(address_of(value))  # numpy's view of it is read-only
        yield np.frombuffer(memoryview(own), value.dtype)
    elif isinstance(value, tuple | list | Mapping):
        for one in value.values() if isinstance(value, Mapping) else value:
            yield from arrays_in(one)


def _layout(blocks: Sequence[Block]) -> str:
    return hashlib.sha256(repr([(str(one.dtype), one.shape) for one in blocks]).encode()).hexdigest()
