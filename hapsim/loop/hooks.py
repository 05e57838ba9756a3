"""Hooks that an exchange calls by address, each compiled by itself, all with one signature, in three lists.

An exchange fills a TICK and calls one list of hooks before the scene moves, one after it, and one after the force is
limited. Within a list the hooks are in the order of Stage. A hook reads the TICK and the records to which it has
addresses, keeps its state in a record of its own, and returns 0 or the code that ends the run. A hook that a scene
lacks costs nothing and is never compiled. Any other is compiled once, whatever other hooks the scene has.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from enum import IntEnum
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numba import types

from firmware_protocol import schema
from firmware_protocol.compiled import ONE
from firmware_protocol.description import Description
from hapsim.compiling import inlined
from hapsim.compiling.native import PlainNative, address_of, array_at, function_at, native, record_at
from hapsim.cordis.dispatch import CALLS
from hapsim.loop.buffers import IO_BUFFER
from hapsim.scene import Scene

if TYPE_CHECKING:
    from hapsim.prediction.force_bounds import ForceBounds

TICK = np.dtype(
    [
        ("address", np.uint64),  # of all this
        ("io", np.uint64),  # address of the IO_BUFFER: positions and forces
        ("history", np.uint64),  # address of the FORCE_HISTORY
        ("number", np.int64),  # of this tick; the first one is 0
        ("sample", np.int64),  # number of the newest position, counted from arming,
        ("gap", np.int64),  # and samples from the one before to it
        ("now_ns", np.int64),  # when it arrived,
        ("before_ns", np.int64),  # when the one before arrived,
        ("begun_ns", np.int64),  # and when the host began the tick whose force requested it
        ("age", np.int64),  # samples from the position that the acting force answers
        ("late", np.int64),  # 1: the device reports that no force came in time, and the loop does not expect that
        ("missed", np.int64),  # deadline misses up to now
        ("unsent", np.int64),  # 1: the force of the tick before was never sent
        ("expired", np.int64),  # 1: the time to live of the last sent force is over
        ("withheld", np.int64),  # 1: the position is older than a force may live, so zero is sent
        ("flags", np.int64),  # of the row (ring.py); a hook that changes the force adds its own
        ("ending", np.int64),  # the code that ends the run, 0: none
        ("push", np.float64, (schema.MAX_CHANNELS,)),  # N, which a hook adds to the excitation of its channel
        ("held", np.float64),  # J, stored in the scene at the first sample
    ],
    align=True,
)
"""The newest position, for hooks. The exchange fills it once for each position."""

HOOK = types.int64(types.uint64, types.uint64)
hook = native(HOOK.return_type, *HOOK.args)
"""Decorates a hook (own, tick): addresses of a record of its own and of a TICK, so that it begins with
`own, tick = _own_at(own), tick_at(tick)`. It returns 0, or the code that ends the run before its force is sent."""

call_hook = function_at(HOOK)
tick_at, io_at, _words_at = record_at(TICK), record_at(IO_BUFFER), array_at(np.uint64)


class Stage(IntEnum):
    """The stage of a tick in which a hook is called. A list of calls has several stages, in this order."""

    READ = 0  # may read the measured position
    PREDICT = 1  # may replace it
    ADD = 2  # the scene has moved: may add to its force
    LEAD = 3  # may set `push`
    LOWER = 4  # the force is limited and in counts: may lower it
    SHAPE = 5  # may keep it near the one before
    KEEP = 6  # the force is final: may record it
    JUDGE = 7  # may end the run


_LISTS = {
    "before_scene": {Stage.READ, Stage.PREDICT},
    "after_scene": {Stage.ADD, Stage.LEAD},
    "after_limit": {Stage.LOWER, Stage.SHAPE, Stage.KEEP, Stage.JUDGE},
}

HOOKS = np.dtype([(name, CALLS) for name in _LISTS], align=True)


@inlined
def call_hooks(calls, tick):
    """Calls the hooks of a list, in order. If several end the run, the code nearest to 0 counts."""
    pairs = _words_at(calls.pairs, 2 * calls.count)
    for i in range(np.uint64(calls.count)):
        code = call_hook(pairs[i + i], (pairs[i + i + ONE], tick.address))
        if code != 0 and (tick.ending == 0 or code > tick.ending):
            tick.ending = code


class Hook(NamedTuple):
    """A hook of a loop."""

    stage: Stage
    function: PlainNative
    record: Any
    """Record of its state."""
    kept: Any = None
    """Objects that must stay in memory with it."""


def set_hooks(hooks: Any, chosen: Iterable[Hook]) -> list[Any]:
    """Fills HOOKS; hooks of one stage are called in the order of `chosen`. Returns the lists of calls, which must stay
    in memory, like `chosen`. Each list has room for two more, for `add_hooks`."""
    ordered, lists = sorted(chosen, key=lambda one: one.stage), []
    for name, stages in _LISTS.items():
        pairs = [(one.function.address(), address_of(one.record)) for one in ordered if one.stage in stages]
        lists.append(np.array([*pairs, (0, 0), (0, 0)], np.uint64))
        hooks[name].pairs, hooks[name].count = address_of(lists[-1]), len(pairs)
    return lists


def add_hooks(hooks: Any, lists: Sequence[Any], more: Iterable[Hook]) -> None:
    """Adds hooks to HOOKS and the lists of `set_hooks`, behind the others; a loop may run meanwhile."""
    for one in more:
        for (name, stages), calls in zip(_LISTS.items(), lists, strict=True):
            if one.stage in stages:
                calls[hooks[name].count] = one.function.address(), address_of(one.record)
                hooks[name].count += 1


class Setting(NamedTuple):
    """Input of the guards' set-up."""

    scene: Scene
    description: Description
    bounds: ForceBounds
    in_hand: bool
    """True if a hand may hold the device: it is behind a port, and does not run in virtual time."""
    behind_port: bool = False
    judges_energy: bool = False
    judges_sign: bool = False
    known_motors: tuple[int, ...] = ()
    """Channels whose motor is known to push the right way: the sign guard plans no tests of them."""
    first_late: str = ""
    """Delay of the wire, in words, if most first forces may be late and the scene is unstable then; else ""."""


class EndedRun(NamedTuple):
    """A run that a guard ended, for its sentence."""

    loop: Any
    """LOOP."""
    report: Any
    """Report of hapsim.recording."""
    scene: Scene
    """The scene that the loop moved."""
    setting: Setting


class Guard(NamedTuple):
    """A guard, as set-up, exchange and report use it."""

    name: str
    """Name of its field of LOOP."""
    record: np.dtype[Any]
    """Type of that field, which holds its state."""
    hooks: Mapping[Stage, PlainNative]
    """Hooks that an exchange calls, by stage."""
    set_up: Callable[[Any, Setting], Any]
    """Function that fills the record of a LOOP and returns it; None if the scene does not need the guard."""
    code: int = 0
    """Code that ends a run; 0: the guard ends none. If two guards end a run, the code nearest to 0 is reported."""
    words: str = ""
    """`ending` of a report."""
    sentence: Callable[[EndedRun], str] = lambda _: ""
    """Function that returns the finding and the remedy, without a full stop."""
    advice: Callable[[EndedRun], str] = lambda _: ""
    """Function that returns further remedies if no value of the scene is unlikely, without a full stop."""
    stopped_motor: Callable[[Any], int] = lambda _: -1
    """Function of a LOOP whose run it ended: the channel whose motor may push the wrong way; -1: no motor's fault."""
    reads_history: bool = False
    """True if it judges by the forces that acted (force_history.py)."""
    mode: str = ""
    """The `mode` of the devices that it guards; "": of all."""
