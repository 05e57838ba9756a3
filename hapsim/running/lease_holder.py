"""The lease of a session: who holds it, the fallback that follows when it runs out, and what a record notes of it."""

from __future__ import annotations

import contextlib
import itertools
import json
import math
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager
from typing import Any

import numpy as np

from firmware_protocol.compiled import new_record
from hapsim.compiling.native import address_of
from hapsim.cordis.program import compile_scene
from hapsim.errors import UsageError
from hapsim.loop.lease import FADE_S, LEASE, lease_hooks
from hapsim.loop.posted import copy_blocks
from hapsim.prediction.correction import rendered
from hapsim.prediction.mixture import braked, shaken_while_taking_over
from hapsim.running.assemble_loop import LoopMemory
from hapsim.running.live_parameters import is_number, shown
from hapsim.running.snapshot import arrays_in
from hapsim.scene import Scene, parse_scene
from hapsim.scene.choices import PREDICTS

SHORTEST_S, LONGEST_S = 0.005, 3600.0
_POLL_S = 5e-5


class Lease:
    """The lease of a running loop. Any thread may call it."""

    def __init__(
        self,
        loop: LoopMemory,
        is_running: Callable[[], bool],
        unchanged: Callable[[], AbstractContextManager[Scene]],
        in_background: Callable[[Callable[[], object]], None],
    ) -> None:
        """`is_running`: returns whether a loop takes requests. `unchanged`: holds up changes of the scene, and gives
        it. `in_background`: does something in a thread of idle priority, and waits for it."""
        self._loop, self._is_running, self._unchanged, self._in_background = loop, is_running, unchanged, in_background
        self._asking, self._noting = threading.Lock(), threading.Lock()
        self._own: Any = None  # LEASE, once there was a lease
        self._kept: tuple[Any, ...] = ()  # memory of the fallback
        self._owner: object = None
        self._posted: dict[str, Any] | None = None  # the note of the last request, if the loop may not have taken it
        self._notes: deque[dict[str, Any]] = deque()
        self._ends, self._seen = deque[int](), 0
        self.seconds: float | None = None
        """Length of the lease, s; None: there is none."""
        self.fallback: Scene | None = None
        """The fallback as it is run; None before the first lease."""

    @property
    def is_out(self) -> bool:
        """True from when the lease ran out until it is renewed or ended: from when that is asked on, so that a change
        may follow at once."""
        own = self._own  # `taken` before `is_out`, which the loop writes first
        return own is not None and own.taken == own.asked and bool(own.is_out)

    @property
    def weight(self) -> float:
        """Share of the fallback's force, 0 to 1."""
        return 0.0 if self._own is None else float(self._own.weight)

    def ask(self, seconds: float | None, fallback: Scene | None = None, owner: object = None) -> str:
        """Begins, renews or ends a lease, as `Session.lease` does. Returns what of it is news: "begun", "renewed" after
        it had run out, "ended"; else ""."""
        with self._asking:
            was_out, before = self.is_out, self.seconds
            if before is not None and not was_out and owner != self._owner:
                raise UsageError("another client holds the lease: only that one can renew it, until it runs out")
            if seconds is None:
                if before is not None:
                    self._post(0.0, {"lease": None})
            elif not is_number(seconds) or not SHORTEST_S <= seconds <= LONGEST_S:
                expected = f"{SHORTEST_S:g} to {LONGEST_S:g} s"
                raise UsageError(
                    f"lease: found {shown(seconds)}{' s' if is_number(seconds) else ''}, expected {expected}"
                )
            else:
                if before is None:
                    self._prepare(fallback)
                elif fallback is not None:
                    raise UsageError("the fallback cannot change while a lease is on: end the lease first")
                note = {} if fallback is None else {"fallback": fallback.ranged_document}
                self._post(seconds, {"lease": seconds, **note})
            self.seconds, self._owner = seconds, owner
        if seconds is None:
            return "" if before is None else "ended"
        return "begun" if before is None else "renewed" if was_out else ""

    def renew(self, owner: object = None) -> str:
        """Renews the lease for as long as before; once it has run out anyone may, and its owner stays. Returns as
        `ask`."""
        if self.seconds is None:
            raise UsageError("found no lease to renew, expected one that was begun with its seconds")
        return self.ask(self.seconds, owner=self._owner if self.is_out else owner)

    def require_kept(self) -> None:
        """Raises UsageError while the lease has run out."""
        if self.is_out:
            raise UsageError("the lease has run out, and the fallback holds the hand: renew the lease before a change")

    def require_stable(self, scene: Scene) -> None:
        """Raises UsageError if a lease is on, and its fallback cannot take over from `scene`."""
        if self.seconds is not None and self.fallback is not None:
            _require_stable(scene, self.fallback)

    def take_notes(self) -> Iterator[dict[str, Any]]:
        """Yields the requests that the loop has taken since the last call, each with its "tick" and "lease"."""
        self._note_taken()
        for _ in range(len(self._notes)):
            yield self._notes.popleft()

    def new_ends(self) -> Iterator[int]:
        """Yields the samples at which the lease ran out since the last call."""
        self._note_taken()
        for _ in range(len(self._ends)):
            yield self._ends.popleft()

    @contextlib.contextmanager
    def settled(self) -> Iterator[dict[str, Any] | None]:
        """Holds up requests, and gives the state of the lease once the loop has taken all; None before the first."""
        with self._asking:
            self._wait_for_turn()
            fallback = self.fallback
            yield None if fallback is None else {"seconds": self.seconds, "fallback": fallback.document}

    def restore(self, state: Mapping[str, Any]) -> None:
        """Installs the lease of a recorded state into a loop that is then put into that state. Raises SceneError."""
        self.seconds = state["seconds"]
        self._install(parse_scene(json.dumps(state["fallback"]), "the fallback"))

    def _install(self, fallback: Scene) -> None:
        """Compiles a fallback, as it is run, and puts it into the loop. None may act meanwhile."""
        loop, slot = self._loop, self._loop.record.slot
        program = compile_scene(fallback)
        program.call_all_of("place")
        loop.account_for(program, fallback)
        own = new_record(LEASE) if self._own is None else self._own
        own.counts_samples, own.scene = loop.is_virtual, address_of(slot)
        own.steps, own.copy = max(1, math.floor(FADE_S * fallback.rate)), copy_blocks.address()
        own.fallback.address = address_of(own.fallback)
        own.fallback.substeps, own.fallback.mean = slot.substeps, slot["mean"]
        changing = [block for block in arrays_in(program.memory) if block.flags.writeable]
        initial = [block.copy() for block in changing]
        rows = [(address_of(a), address_of(b), b.nbytes) for a, b in zip(initial, changing, strict=True)]
        words = np.array([len(rows), *itertools.chain(*rows)], np.int64)
        own.blocks, own.fallback.program = address_of(words), program.address
        self._kept, self.fallback, loop.fallback = (changing, initial, words), fallback, program
        if self._own is None:
            loop.add_hooks(lease_hooks(own))
        self._own = own

    def _prepare(self, wanted: Scene | None) -> None:
        """Requires a fallback that can take over, and installs it. `wanted`: None for dampers."""

        def prepare() -> None:
            """Prepares the fallback while the scene stays as it is."""
            with self._unchanged() as scene:
                _require_supported(scene)
                fallback = braked(scene) if wanted is None else rendered(wanted).scene
                _require_stable(scene, fallback)
                while self.weight > 0.0 and self._is_running():  # a lease before, which was ended
                    time.sleep(_POLL_S)
                self._install(fallback)

        self._in_background(prepare)

    def _post(self, seconds: float, note: dict[str, Any]) -> None:
        self._wait_for_turn()  # not for the mailbox: a renewal must not wait for a change that is being judged
        own = self._own
        with self._noting:
            own.length = math.ceil(seconds * (self._loop.rendered_scene.rate if own.counts_samples else 1e9))
            self._posted = note
            own.asked += 1

    def _wait_for_turn(self) -> None:
        own = self._own
        while own is not None and own.taken != own.asked and self._is_running():
            time.sleep(_POLL_S)
        self._note_taken()

    def _note_taken(self) -> None:
        with self._noting:
            if self._own is not None and self._own.out_count != self._seen:
                self._seen = int(self._own.out_count)
                self._ends.append(int(self._own.out_sample))
            if self._posted is not None and self._own.taken == self._own.asked:
                self._notes.append({"tick": int(self._own.tick), "sample": int(self._own.sample), **self._posted})
                self._posted = None


def _require_supported(scene: Scene) -> None:
    """Raises UsageError for a scene from which no fallback can take over."""
    device = scene.device
    for key, found, expected in (
        ("law", device.law == "board" and "board", "host"),
        ("correction", device.correction in PREDICTS and device.correction, "none, poles or sensed"),
    ):
        if found:
            raise UsageError(f"device.{key}: found {found}, expected {expected}: a lease is not worked out with it")


def _require_stable(scene: Scene, fallback: Scene) -> None:
    """Raises UsageError if a hand is shaken while the fallback, as it is run, takes over."""
    found = shaken_while_taking_over(rendered(scene).scene, fallback)
    if found is not None:
        where = {0.0: "the scene", 1.0: "the fallback"}.get(found.weight, f"{found.weight:.0%} of the fallback")
        raise UsageError(f"no lease: {where} is predicted unstable: {found.shaking.sentence(scene.units)}")
