"""Changing a scene while it runs.

If only live parameters differ, they ramp to their new values. For any other difference in the modules, another program
is compiled in the background, and the running loop then crossfades to it.
"""

from __future__ import annotations

import contextlib
import math
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict
from typing import Any

import numpy as np

from hapsim.cordis.dispatch import Column
from hapsim.cordis.program import compile_scene, parameter_values
from hapsim.cordis.succession import take_over_from
from hapsim.errors import UsageError
from hapsim.loop.background import BackgroundWork
from hapsim.loop.guards.energy_guard import set_predicted_unstable
from hapsim.loop.posted import Mailbox
from hapsim.prediction import surely_shaken_by
from hapsim.prediction.correction import Rendering, rendered
from hapsim.prediction.predict import is_soon_stable
from hapsim.running.assemble_loop import LoopMemory
from hapsim.running.changed_scene import (
    Changes,
    changed,
    differs_in_live_parameters_alone,
    first_fixed_difference,
    is_equal,
    needs_crossfade,
    require_restartable,
)
from hapsim.running.lease_holder import Lease
from hapsim.running.live_parameters import (
    MOCK_HAND,
    MOCK_INPUTS,
    OUTPUTS,
    checked_words,
    is_number,
    parts_of,
    shown,
)
from hapsim.running.pulse_shapes import Pulse
from hapsim.running.requirements import require_in_time, require_not_less_stable
from hapsim.running.snapshot import LoopState, take_state
from hapsim.scene import Scene
from hapsim.scene.section import Table

OVER = "the run is over: nothing can be changed any more"

_LONGEST = 2.0**40  # samples
_POLL_S = 1e-3
_MOST_STATES = 250  # of a scene that is judged in the caller's thread, in some milliseconds
_OF_MOCK = {MOCK_HAND: "a hand that holds a real device", MOCK_INPUTS: "what a real device reads"}


class LiveScene:
    """The scene of a running loop. Any thread may change it, one after the other."""

    def __init__(
        self,
        scene: Scene,
        loop: LoopMemory,
        is_over: Callable[[], bool] = lambda: False,
        idle_priority: bool = False,
        unstable: bool | None = None,
    ) -> None:
        """`is_over`: whether the loop has ended. `idle_priority`: preparations run in a thread of idle priority.
        `unstable`: as of `start`."""
        self.scene = scene
        """The scene with every change so far."""
        self._loop, self._is_over, self._idle_priority, self._unstable = loop, is_over, idle_priority, unstable
        self._replacing, self._writing = threading.Lock(), threading.Lock()
        self._mailbox = Mailbox(loop.record.posted, lambda: self._is_running)
        self.lease = Lease(loop, lambda: self._is_running, self._unchanged, self._run_in_background)
        self._notes: deque[dict[str, Any]] = deque()
        self._noting = threading.Lock()
        self._outputs = int(loop.record.words.set)  # with every change so far
        self._posted: tuple[int, dict[str, Any], bool] | None = None  # the last change, if it may not be noted yet
        self._ramps_from = self._fades_from = 0  # samples in which the last ramp and the last crossfade began
        self._trial: int | None = None  # number of the one that begins
        self._settled: deque[tuple[int, int]] = deque()
        self._older = scene  # the one that a crossfade began with
        self._values: Column | None = None  # of its parameters; None: not computed yet
        self._judging, self._is_judging = threading.Lock(), False
        self._unjudged: tuple[Scene, int] | None = None  # the last change that runs unjudged, and its samples
        self.is_shaken: Callable[[Scene], bool] = lambda one: surely_shaken_by(one) is not None
        """Returns whether a scene surely shakes a hand."""

    def set(self, changes: Changes, over: float) -> None:
        """Changes live parameters, as `Session.set` does."""
        self._set(changes, over, {})

    def trial(self, number: int, changes: Changes, restart: Sequence[str], over: float) -> None:
        """Begins a trial, as `Session.trial` does; for one thread at a time."""
        require_restartable(self.scene, restart)
        self._note_taken()
        if self._trial is not None:
            raise UsageError(f"trial {number}: trial {self._trial} still begins, expected it to have settled")
        self._set(changes, over, {"trial": number, "restart": [*restart]})
        self._trial = number

    def _set(self, changes: Changes, over: float, trial: dict[str, Any]) -> None:
        words = checked_words(self.scene, changes)
        of_scene = {name: values for name, values in changes.items() if name not in words} if words else changes
        replaces = bool(trial.get("restart")) or needs_crossfade(self.scene, of_scene)

        def change(in_background: bool = True) -> bool:
            """Judges and posts the change. Returns False if that takes too long here."""
            with self._replacing if replaces else self._writing:
                scene = changed(self.scene, of_scene)
                self._require_mock(changes)
                is_judged = self._unstable is False and scene.modules is not self.scene.modules
                is_judged = is_judged and scene.at is None  # several devices are judged together
                if is_judged and not is_soon_stable(scene, _MOST_STATES):
                    if not in_background:
                        return False
                    require_not_less_stable(self.scene, scene)
                if self._loop.inputs is not None:
                    self._loop.inputs.set(words.get(MOCK_INPUTS, {}))
                recorded = {name: values for name, values in changes.items() if name not in _OF_MOCK}
                note = {**trial, "set": recorded, "over": over}
                (self._change_to if replaces else self._ramp_to)(scene, over, note)
                return True

        # In the background: predicting a large scene takes seconds, and so does compiling one.
        if replaces or not change(in_background=False):
            self._run_in_background(change)

    def adopt(self, scene: Scene, over: float) -> None:
        """Changes to `scene`, as `Session.adopt` does."""
        note = {"adopt": scene.ranged_document, "over": over}
        _samples(scene, over)  # raises first
        if scene.path is None:  # it was sent, or made: the file stays that of the running scene
            scene = scene.read_from(self.scene.path, self.scene.origin)

        def change() -> None:
            """Requires the scene to be possible, and changes to it."""
            with self._replacing:
                self._require_possible(scene)
                self._change_to(scene, over, note)

        self._run_in_background(change)

    def pulse(self, pulse: Pulse) -> None:
        """Begins a pulse in the next tick. UsageError while another one runs on its channel."""
        with self._writing:
            self._wait_for_turn()
            pulses, channel = self._loop.pulses, pulse.channel
            if pulses.is_running(channel, int(self._loop.state.sample)):
                raise UsageError(f"channel: found {channel}, on which a pulse runs; expected one that is free, or wait")
            self._loop.add_pulse_hooks()
            for field, word in pulses.words(channel, pulse.forces(self.scene.rate)).items():
                self._mailbox.add(pulses.record, field, word, channel)
            self._send({"pulse": asdict(pulse)})

    def ask_for_lease(self, seconds: float | None, fallback: Scene | None = None, owner: object = None) -> str:
        """Begins, renews or ends a lease, as `Session.lease` does. Returns what of it is news, as `Lease.ask` does."""
        return self.lease.ask(seconds, fallback and self._on_this_device(fallback), owner)

    @property
    def _is_running(self) -> bool:
        return bool(self._loop.control.go and self._loop.state.ticks) and not self._is_over()

    @contextlib.contextmanager
    def _unchanged(self) -> Iterator[Scene]:
        with self._replacing, self._writing:
            yield self.scene

    def note_saved(self, file: Scene) -> None:
        """Notes that the scene was saved: it is as if read from the file of `file`."""
        with self._writing:
            self.scene = self.scene.read_from(file.path, file.origin)

    def state(self) -> LoopState | None:
        """Returns the state of the loop between two ticks; None before the first. UsageError once the run is over."""
        with self.lease.settled() as lease, self._writing:
            self._wait_for_turn()
            if not self._is_over() and not self._loop.state.ticks:
                return None
            taken = take_state(self._loop, self._mailbox, [self._older, self.scene], lease)
            if taken is None:
                raise UsageError(OVER)
            return taken

    def take_notes(self) -> list[dict[str, Any]]:
        """Returns the changes that the loop has taken since the last call, each with its "tick" and "sample", and with
        what it was: "set" (changes), "adopt" (document of a scene), "trial" (number), "pulse"."""
        self._note_taken()
        return [*(self._notes.popleft() for _ in range(len(self._notes))), *self.lease.take_notes()]

    def take_settled(self) -> list[tuple[int, int]]:
        """Returns the trials that have settled since the last call: the number of each, and the last sample of its ramp
        and its crossfade."""
        self._note_taken()
        return [self._settled.popleft() for _ in range(len(self._settled))]

    def _note_settled(self) -> None:
        if self._trial is not None and self._posted is None and self._is_settled:
            ramp, fade, steps = self._loop.program.record.parameters, self._loop.record.slot, self.scene.substeps
            ends = (self._ramps_from, ramp.moved), (self._fades_from, fade.moved)
            last = max(first + math.ceil(moved / steps) for first, moved in ends) - 1
            self._settled.append((self._trial, last))
            self._trial = None

    @property
    def _is_settled(self) -> bool:
        """True if no ramp and no crossfade is under way."""
        parameters, last = self._loop.program.record.parameters, self._mailbox.next_number - 1
        is_over = parameters.posted == parameters.taken and parameters.left == 0.0
        return self._mailbox.taken_in(last) is not None and is_over and not self._loop.is_replacing

    def begun_in(self) -> int:
        """Waits until the loop has taken the last change. Returns the sample in which it began. UsageError once the run
        is over."""
        self._mailbox.wait()
        if (taken := self._mailbox.taken_in(self._mailbox.next_number - 1)) is None:
            raise UsageError(OVER)
        return taken[1]

    def _note_taken(self) -> None:
        with self._noting:
            if self._posted is not None and (taken := self._mailbox.taken_in(self._posted[0])) is not None:
                _, note, fades = self._posted
                self._notes.append({"tick": taken[0], "sample": taken[1], **note})
                self._ramps_from = taken[1] if "over" in note else self._ramps_from
                self._fades_from = taken[1] if fades else self._fades_from
                self._posted = None
            self._note_settled()

    def _wait_for_turn(self) -> None:
        self._mailbox.wait()
        self._note_taken()

    def _send(self, note: dict[str, Any], fades: bool = False) -> None:
        if self._is_over():
            raise UsageError(OVER)
        if outputs := _outputs_in(note):
            self._outputs = self.output_words(outputs)
            self._mailbox.add(self._loop.record.words, "set", self._outputs)
        self._posted = self._mailbox.next_number, note, fades
        self._mailbox.send()

    def _require_mock(self, changes: Changes) -> None:
        """Raises UsageError for changes of a mock that is no part of this process."""
        if self._loop.hand is None and (of_mock := [name for name in changes if name in _OF_MOCK]):
            raise UsageError(
                f"{of_mock[0]}: the device is no mock of this process; {_OF_MOCK[of_mock[0]]} cannot be set"
            )

    def _run_in_background(self, work: Callable[[], object]) -> None:
        if self._idle_priority:
            BackgroundWork(work).result()
        else:
            work()

    def output_words(self, values: Mapping[str, int]) -> int:
        """Returns the `set` of WORDS_STATE with other values of some outputs, by name."""
        word = self._outputs
        for name, value in values.items():
            output = self.scene.outputs[name]
            word = word & ~output.mask | value << output.shift
        return word

    @property
    def word_values(self) -> dict[str, int]:
        """Present values of the outputs that programs set ("outputs.code"), and of the mock's inputs, by name."""
        word, outputs, inputs = self._outputs, self.scene.outputs, self._loop.inputs
        found = {f"{OUTPUTS}.{name}": one.value(word) for name, one in outputs.items() if one.is_set_by_programs}
        return found | {f"{MOCK_INPUTS}.{name}": value for name, value in (inputs.values if inputs else {}).items()}

    def _change_to(self, scene: Scene, over: float, note: dict[str, Any]) -> None:
        restarts = bool(note.get("restart"))
        if not restarts and differs_in_live_parameters_alone(self.scene, scene):
            with self._writing:
                self._ramp_to(scene, over, note)
        elif restarts or scene != self.scene:
            self._replace(scene, _samples(scene, over), note)

    def _ramp_to(self, scene: Scene, over: float, note: dict[str, Any]) -> None:
        """Posts the values of `scene`, if any differs or a trial begins, and those of the note's outputs."""
        samples, rendering = _samples(scene, over), rendered(scene)
        values = parameter_values(rendering.scene)
        if self._values is None:
            self._values = parameter_values(self._loop.rendered_scene)
        self._move_hand(scene, samples)
        differs = "trial" in note or not np.array_equal(values, self._values)
        if differs or _outputs_in(note):
            self._wait_for_turn()
            if differs:
                self._guard_strictly(scene, samples)
                self._loop.program.parameters.post(values, samples * scene.substeps, self._mailbox.add)
                self._fade_correction(rendering, samples)
            self._send(note)
        self.scene, self._loop.rendered_scene, self._values = scene, rendering.scene, values

    def _replace(self, scene: Scene, samples: int, note: dict[str, Any]) -> None:
        """Compiles the program of `scene` and crossfades to it. Only the last lines hold `_writing`."""
        rendering = rendered(scene)
        after = rendering.scene
        require_in_time(after, self._loop.is_virtual)
        program = compile_scene(after)
        self._wait_for_turn()
        while self._loop.is_replacing:
            if self._is_over():
                raise UsageError(OVER)
            time.sleep(_POLL_S)
        with self._writing:
            self._wait_for_turn()
            self._guard_strictly(scene, samples)
            take_over_from(self._loop.program, self._loop.rendered_scene, program, after, note.get("restart", ()))
            self._loop.account_for(program, after)
            program.parameters.post(parameter_values(after), samples * scene.substeps)
            self._loop.crossfade_to(program, samples * scene.substeps, self._mailbox)
            self._fade_correction(rendering, samples)
            self._send(note, fades=True)
            self._move_hand(scene, samples)
            self._older = self.scene
            self.scene, self._loop.rendered_scene, self._values = scene, after, None

    def _move_hand(self, scene: Scene, samples: int) -> None:
        if self._loop.hand is not None and parts_of(scene)[MOCK_HAND] != parts_of(self.scene)[MOCK_HAND]:
            self._loop.hand.retarget(scene, samples)

    def _guard_strictly(self, scene: Scene, samples: int) -> None:
        """Has the energy guard apply its stricter rules before a change acts, where unstable scenes may run: until the
        scene is judged, and as long as it is predicted unstable."""
        if not (self._unstable and self._loop.has_energy_guard):
            return
        with self._judging:
            set_predicted_unstable(self._loop.record.energy_guard, unstable=True)
            self._unjudged, is_waited_for = (scene, samples), self._is_judging
            self._is_judging = True
        if not is_waited_for:
            BackgroundWork(self._judge, self._idle_priority)

    def _judge(self) -> None:
        """Judges the scene of the latest change, and again while there are newer ones."""
        while True:
            with self._judging:
                if (latest := self._unjudged) is None:
                    self._is_judging = False
                    return
            is_shaken = True
            with contextlib.suppress(UsageError):  # too large to predict
                is_shaken = self.is_shaken(latest[0])
            with self._judging:
                if self._unjudged is latest:
                    self._unjudged = None
                    if not is_shaken:
                        set_predicted_unstable(self._loop.record.energy_guard, unstable=False, samples=latest[1])

    def _fade_correction(self, rendering: Rendering, samples: int) -> None:
        if self._loop.correction is not None:
            self._loop.correction.fade_to(rendering, samples, self._mailbox)

    def _on_this_device(self, fallback: Scene) -> Scene:
        """Returns a fallback without sound. Raises UsageError if it cannot take over from the running scene."""
        now = self.scene
        device = fallback.device.model_copy(update={"port": now.device.port})
        of_now = {key: getattr(now, key) for key in ("sound", "mock", "outputs")} | {"device": device}
        as_now = fallback.model_copy(update=of_now | ({} if fallback.inputs else {"inputs": now.inputs}))
        fixed = first_fixed_difference(now, as_now)
        fixed = fixed or next((key for key in ("scheme", "space") if getattr(now, key) != getattr(fallback, key)), "")
        if fixed:
            raise UsageError(f"fallback: found another {fixed} than that of the running scene, expected the same")
        self._require_on_device(fallback, "fallback: ")
        return as_now.model_copy(update={"sound": Table({}), "outputs": Table({})})

    def _require_possible(self, scene: Scene) -> None:
        fixed = first_fixed_difference(self.scene, scene)
        if fixed:
            raise UsageError(f"{fixed} cannot change while the scene runs: stop it and start it anew")
        if self._loop.hand is None and not is_equal(parts_of(self.scene)[MOCK_HAND], parts_of(scene)[MOCK_HAND]):
            self._require_mock({MOCK_HAND: {}})
        self._require_on_device(scene)
        if not self._unstable:
            require_not_less_stable(self.scene, scene)
        self.lease.require_stable(scene)

    def _require_on_device(self, scene: Scene, which: str = "") -> None:
        """Raises UsageError, after the words `which`, if the armed device lacks channels or velocities of a scene."""
        io = self._loop.record.io
        if scene.channels > io.channels:
            raise UsageError(f"{which}the device has {io.channels} channel(s), the scene uses {scene.channels}")
        if scene.sensed_links and not io.velocities:
            raise UsageError(
                f"{which}{scene.sensed_links[0]}: damper: sensed needs the device's velocities, which were not "
                "requested at arming: stop the scene and start it again, or write damper: backward"
            )


def _outputs_in(note: Mapping[str, Any]) -> dict[str, int]:
    """Returns the values of outputs in a note of a change, by name."""
    return {name: int(value) for name, value in note.get("set", {}).get(OUTPUTS, {}).items()}


def _samples(scene: Scene, over: float) -> int:
    """Returns the duration of a ramp of `over` seconds in samples, at least 1."""
    sound = is_number(over) and math.isfinite(over) and over >= 0
    samples = math.ceil(over * scene.rate) if sound else -1
    if not 0 <= samples <= _LONGEST:
        raise UsageError(f"over: found {shown(over)} s, expected the duration of the change in seconds, 0 or more")
    return max(samples, 1)
