"""Assembling a loop for a scene and a device: all its memory, allocated and touched once."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import TYPE_CHECKING, Any

import numpy as np

from firmware_protocol import schema
from firmware_protocol.compiled import new_record
from firmware_protocol.description import Description
from firmware_protocol.frames import armed_format, framing_of
from hapsim.compiling.native import address_of
from hapsim.cordis.program import Program, compile_scene
from hapsim.cordis.stored_energy import StoredEnergy
from hapsim.device.connection import Connection
from hapsim.holds import HOLDS
from hapsim.loop import guards
from hapsim.loop.board_law import board_hooks
from hapsim.loop.crossfade import cross_fade
from hapsim.loop.events import Events, events_hook
from hapsim.loop.exchange import DEVICE_CLOCK, HOST_CLOCK, LOOP, MEMORY_CLOCK, NO_CLOCK
from hapsim.loop.force_history import history_hook
from hapsim.loop.guards.armed_inside import inside_sentence
from hapsim.loop.guards.energy_guard import set_predicted_unstable
from hapsim.loop.guide import guide_hook
from hapsim.loop.hooks import Hook, Setting, add_hooks, set_hooks
from hapsim.loop.output_words import words_hook
from hapsim.loop.posted import Mailbox
from hapsim.loop.pulse import LoopPulses
from hapsim.loop.ring import SENSED, Ring, row_type, sensed_by
from hapsim.loop.simulated_mass import admittance_hooks
from hapsim.loop.sound import SoundRing, add_frame
from hapsim.loop.transport import Transport
from hapsim.prediction import surely_shaken_by, timing
from hapsim.prediction.correction import rendered
from hapsim.prediction.force_bounds import force_bounds
from hapsim.prediction.linear import fastest_motion
from hapsim.running.correction_setup import LoopCorrection
from hapsim.running.sensor_check import SensorCheck
from hapsim.running.session_options import Excitation, PeriodicExcitation, RunOptions
from hapsim.scene import Scene
from hapsim.sound.play import SoundOutput

if TYPE_CHECKING:
    from hapsim.device.mock.stand_ins import LiveHand, LiveInputs

_RING_ROWS = 1 << 16
_SOUND_S, _LEAST_FRAMES = 1.0, 4096  # least size of the ring of sound
_CLOCK = {"device": DEVICE_CLOCK, "host": HOST_CLOCK, "lockstep": NO_CLOCK, "paced": MEMORY_CLOCK}
_FOREVER_NS = 1 << 62
_GRACE_NS = 50_000_000  # beyond the duration, until the host's clock ends the run


class LoopMemory:
    """A loop that is ready to run, with everything that must stay in memory meanwhile."""

    def __init__(
        self,
        connection: Connection,
        description: Description,
        parts: int,
        clock: str,
        ring_rows: int | None = None,
        away: int = 0,
    ) -> None:
        """`parts`: those of schema.PARTS on the wire. `clock`: the device's, as in a scene, or "paced": the
        mock in memory, in real time. `ring_rows`: a power of two. `away`: points at other ports."""
        self.record = new_record(LOOP)
        """LOOP of hapsim.loop.exchange."""
        self.inbox = connection.inbox
        self.wire = armed_format(description.channels, parts)
        """Format of an armed device's frames."""
        lines, words = bool(parts & schema.WITH_LINE), bool(parts & schema.WITH_WORDS)
        rows = row_type(description.channels, sensed_by(parts), clock == "host", lines, words, away)
        self.is_virtual = clock == "lockstep"
        """True in virtual time: as fast as possible, and the loop waits for its readers."""
        self.ring = Ring(self.record.ring, rows, ring_rows or _RING_ROWS, waits=self.is_virtual)
        self.control.clock = _CLOCK[clock]
        self.record.inbox = address_of(self.inbox)
        self.record.slot.address = address_of(self.record.slot)
        tick, io = self.record.tick, self.record.io
        tick.address, tick.io, tick.history = address_of(tick), address_of(io), address_of(self.record.history)
        carried = "command_payload" if parts & schema.WITH_COMMANDS else "force_counts"
        io.address, io.lines, io.words, io.payload = tick.io, lines, words, tick.io + io.dtype.fields[carried][1]
        self.record.framing = framing_of(self.wire, to_device=True)
        self.watchdog_samples = 0
        """Samples without a force after which the device releases."""
        self.setting: Setting
        """Input of the guards' set-up."""
        self.rendered_scene: Scene
        """The scene that the loop moves: the newest one, corrected."""
        self.correction: LoopCorrection | None = None
        """The rest of the correction: predictors and the estimate of the mass."""
        self.sensor_check: SensorCheck | None = None
        """The check of the sensed acceleration in a session."""
        self.unknown_motor = ""
        """Sentence about motors that are not known to be right, and therefore have a lower force limit."""
        self.sound: SoundRing | None = None
        """Frames of the scene's pick-ups; None for a scene without pick-ups."""
        self.sound_output: SoundOutput | None = None
        """Playback and file of these frames; None if there is neither."""
        self.excitation: Excitation | PeriodicExcitation | None = None
        """Excitation of the run; the loop reads the forces of a periodic one."""
        self.pulses = LoopPulses(self.record.pulses, self.record.tank)
        """Pulses of the run."""
        self.hooks: list[Hook] = []
        """Hooks that the exchange calls."""
        self.hand: LiveHand | None = None
        """Hand that holds the mock; None if the device is no mock in this process."""
        self.inputs: LiveInputs | None = None
        """Inputs of the mock; likewise."""
        self.has_own_mock = connection.mock is not None
        """True if only this machine can hold up the device: a mock in this process, with nothing between."""
        self.fallback: Program | None = None
        """Program of a lease's fallback; None before the first lease."""
        self._programs, self._changes_before = list[Program](), 0

    @property
    def program(self) -> Program:
        """Program of the newest scene."""
        return self._programs[-1]

    @property
    def moved_programs(self) -> list[Program]:
        """The program that the loop moves, during a crossfade behind the one before it."""
        return self._programs if self.is_replacing else self._programs[-1:]

    def account_for(self, program: Program, scene: Scene) -> None:
        """Accounts for the energy of live changes to `program` of `scene`, if the energy guard is enabled, and for the
        outputs that follow the scene."""
        if scene.follows_modules:
            program.events = Events(program, scene)
        if self.has_energy_guard:
            limit = float(self.record.io.force_limit[: self.wire.channels].max())
            program.stored = StoredEnergy(program, scene, self.record.tank, limit)

    @property
    def has_energy_guard(self) -> bool:
        """True if the energy guard is enabled."""
        return bool(self.record.tank.address)

    def set_hooks(self, hooks: Iterable[Hook]) -> None:
        """Sets the hooks that the exchange calls."""
        self.hooks = list(hooks)
        self._calls = set_hooks(self.record.hooks, self.hooks)

    def add_hooks(self, hooks: Iterable[Hook]) -> None:
        """Adds hooks, once, behind the others, also while the loop runs."""
        added = list(hooks)
        add_hooks(self.record.hooks, self._calls, added)
        self.hooks += added

    def add_pulse_hooks(self) -> None:
        """Adds the hooks of pulses, if there are none."""
        if not any(hook.record is self.pulses.record for hook in self.hooks):
            self.add_hooks(self.pulses.hooks())

    def set_programs(self, *programs: Program) -> None:
        """Sets the program that the loop moves from the first tick on; two for a loop that is put into a crossfade."""
        self._programs = [*programs]
        self.record.slot.program = programs[0].address
        for program in programs:
            self._read_inputs(program)

    def _read_inputs(self, program: Program) -> None:
        """Lets the gates of a program follow the device's inputs."""
        offset = self.record.io.dtype.fields["inputs"][1]
        program.record.parameters.inputs = address_of(self.record.io) + offset

    def crossfade_to(self, program: Program, steps: int, mailbox: Mailbox) -> None:
        """Adds to the next change a crossfade to `program`, prepared by `take_over_from`, over `steps` (>= 1)."""
        if self.is_replacing:
            raise ValueError("the crossfade before is not over")
        self._changes_before += sum(int(left.record.parameters.sets) for left in self._programs[:-1])
        self._programs = [self.program, program]
        self._read_inputs(program)
        mailbox.add(self.record.slot, "posted_steps", steps)
        mailbox.add(self.record.slot, "posted", program.address)
        mailbox.add(self.record.slot, "cross_fade", cross_fade.address())

    def add_sound_ring(self, scene: Scene, waits: bool) -> None:
        """Makes the loop write pick-up values into a ring. `waits`: the loop waits for the ring's reader."""
        record, channels = self.record.sound, len(scene.sound)
        capacity = 1 << math.ceil(math.log2(max(_SOUND_S * scene.step_rate, _LEAST_FRAMES)))
        self.sound = SoundRing(record, channels, capacity, waits)
        highpass = np.array([one.highpass for one in scene.sound.values()])
        record.keeps[:channels] = np.exp(-2.0 * np.pi * highpass / scene.step_rate)
        self.record.slot.sound, self.record.slot.add_frame = record.address, add_frame.address()

    def armed_inside(self) -> str:
        """Returns a sentence about a hand that was armed inside a contact; "" if none was."""
        return inside_sentence(self.rendered_scene, self.record.armed_inside)

    @property
    def is_replacing(self) -> bool:
        """True during a crossfade to another scene."""
        return len(self._programs) > 1 and bool(self.record.slot.cross_fade)

    @property
    def changes(self) -> int:
        """Number of sets of live parameters that the loop has taken."""
        return self._changes_before + sum(int(program.record.parameters.sets) for program in self._programs)

    @property
    def control(self) -> Any:
        """CONTROL record: the session's requests to the loop."""
        return self.record.control

    @property
    def state(self) -> Any:
        """STATE record: the loop's reports."""
        return self.record.state


def assemble_loop(
    scene: Scene, connection: Connection, description: Description, options: RunOptions | None = None
) -> LoopMemory:
    """Returns the loop of `scene` over `connection`; arms nothing. Reads the options `duration`, `excitation`,
    `judges_energy`, `judges_sign`, `sound_file` and `unstable`."""
    options = options or RunOptions()
    rendering = rendered(scene)
    ring_rows = _ring_rows(scene, options.duration) if options.is_virtual(scene) else None
    clock = "paced" if options.transport == "paced" else scene.device.clock
    loop = LoopMemory(connection, description, timing.parts_on_wire(scene), clock, ring_rows, len(scene.away))
    if isinstance(connection.transport, Transport):
        loop.inbox.transport = connection.transport.record
    loop.rendered_scene = rendering.scene
    loop.set_programs(compile_scene(rendering.scene))
    if scene.sound:
        loop.add_sound_ring(scene, options.sound_file is not None and loop.is_virtual)
    loop.record.slot.substeps, loop.record.slot.mean = scene.substeps, scene.device.decimation == "mean"
    _set_io(loop.record.io, scene, description)
    _set_control(loop, scene, options.duration)
    loop.excitation = options.excitation
    guide = [] if options.excitation is None else _set_excitation(loop.record, options.excitation, scene)
    loop.correction = LoopCorrection(loop.record, rendering, description)
    loop.watchdog_samples = timing.watchdog_samples(scene.rate, description.max_watchdog_samples)
    loop.setting = _setting_of(loop, scene, connection, description, options)
    words = [events_hook(loop.record.words, loop.record.slot)] if scene.follows_modules else []
    words += [words_hook(loop.record.words)] if scene.has_words else []
    loop.set_hooks([*guide, *loop.correction.hooks, *words, *_guard_hooks(loop, options)])
    loop.has_own_mock = loop.has_own_mock and options.between is None
    if connection.mock is not None:
        from hapsim.device.mock.stand_ins import LiveHand, LiveInputs

        loop.hand, loop.inputs = LiveHand(connection.mock, scene), LiveInputs(connection.mock, scene)
    loop.account_for(loop.program, rendering.scene)
    return loop


def _ring_rows(scene: Scene, duration: float | None) -> int:
    """Returns the ring's rows in virtual time. A short run takes twice its own: the loop returns at half of them."""
    if duration is None:
        return _RING_ROWS
    return min(_RING_ROWS, 1 << math.ceil(math.log2(2.0 * min(duration * scene.rate, _RING_ROWS) + 2.0)))


def _setting_of(
    loop: LoopMemory, scene: Scene, connection: Connection, description: Description, options: RunOptions
) -> Setting:
    limit = float(loop.record.io.force_limit[: description.channels].max())
    in_hand = connection.behind_port and scene.device.clock != "lockstep"  # no hand in virtual time
    samples = timing.least_late_samples(scene, connection.round_trip_s)
    late = options.unstable is False and surely_shaken_by(timing.with_wire_delay(scene, samples)) is not None
    return Setting(
        scene,
        description,
        force_bounds(scene, in_hand=in_hand, judges_energy=options.judges_energy, force_limit=limit),
        in_hand=in_hand,
        behind_port=connection.behind_port,
        judges_energy=options.judges_energy,
        judges_sign=options.judges_sign,
        known_motors=connection.known_motors,
        first_late=timing.lateness_sentences(scene, samples, connection.round_trip_s) if late else "",
    )


def _guard_hooks(loop: LoopMemory, options: RunOptions) -> list[Hook]:
    """Sets up the guards that the scene needs; returns their hooks."""
    hooks, last, reads_history, scene = list[Hook](), list[Hook](), False, loop.setting.scene
    if scene.device.law == "board":
        hooks, last = board_hooks(loop.record, timing.on_wire(scene), loop.setting.description, fastest_motion(scene))
    elif scene.device.is_admittance and (servo := loop.setting.description.servo):
        hooks, last = admittance_hooks(loop.record, scene, servo)
    for guard in (one for one in guards.GUARDS if one.mode in ("", scene.device.mode)):
        record = guard.set_up(loop.record, loop.setting)
        if record is not None:
            hooks += [Hook(stage, function, record) for stage, function in guard.hooks.items()]
            reads_history = reads_history or guard.reads_history
    if options.unstable and loop.has_energy_guard:
        set_predicted_unstable(loop.record.energy_guard, unstable=surely_shaken_by(scene) is not None)
    hooks += last
    if reads_history and scene.device.law == "host":  # lines keep the history themselves
        device = timing.on_wire(scene).device
        hold = HOLDS[device.hold]
        # The mean instant of an averaged position is half a sample earlier.
        shift = (0.5 if device.sampling == "average" else 0.0) + hold.mean_delay - 0.5
        history = loop.record.history
        hooks.append(history_hook(history, delay=device.delay + shift, keeps_last_force=hold.keeps_last_force))
    return hooks


def _set_control(loop: LoopMemory, scene: Scene, duration: float | None) -> None:
    control, virtual = loop.control, loop.is_virtual
    control.samples = -1 if duration is None else max(1, round(duration * scene.rate))
    control.lasts_ns = _FOREVER_NS
    if duration is not None and not virtual:
        control.lasts_ns = min(round(duration * 1e9) + _GRACE_NS, _FOREVER_NS)
    control.go = 1
    control.wire_samples = timing.samples_on_wire(scene)
    control.period_ns = round(1e9 / scene.rate)
    # In virtual time the mock's process may still be compiling.
    control.silence_ns = round(1e9 * (5.0 if virtual else max(0.25, 20.0 / scene.rate)))
    control.time_to_live = timing.time_to_live_samples(scene.rate)
    control.stale_ns = _stale_ns(scene, control)


def _stale_ns(scene: Scene, control: Any) -> int:
    """Returns the age (ns) beyond which a position is answered by zero force. No limit in lockstep."""
    return _FOREVER_NS if scene.device.clock == "lockstep" else (int(control.time_to_live) + 1) * int(control.period_ns)


def _set_excitation(record: Any, excitation: Excitation | PeriodicExcitation, scene: Scene) -> list[Hook]:
    """Sets the excitation. Returns the hooks of its guide, if it has one."""
    control = record.control
    control.pulse_channel = excitation.channel
    if isinstance(excitation, PeriodicExcitation):
        control.periodic, control.periodic_length = address_of(excitation.forces), excitation.forces.size
        return []
    control.pulse_force, control.pulse_ticks = excitation.force, excitation.ticks
    control.pulse_every, control.pulse_from, control.pulse_first = excitation.every, excitation.start, excitation.first
    if (guide := excitation.guide) is not None:
        control.pulse_begin = excitation.ticks_before(scene.rate)
        masses = scene.device.masses(scene.channels)
        targets = ((excitation.channel, guide.target, guide.beyond), *guide.also)
        each = zip(record.guides, targets, strict=False)
        return [guide_hook(own, guide, to, rate_hz=scene.rate, mass=masses[to[0]]) for own, to in each]
    return []


def _set_io(io: Any, scene: Scene, description: Description) -> None:
    channels = description.channels
    io.channels = channels
    io.velocities, io.accelerations, io.hand_forces = (name in scene.sensed for name in SENSED)
    io.position_scale[:channels] = description.position_scale
    io.force_scale[:channels] = description.force_scale
    for c, origin in enumerate(scene.device.origins(scene.channels)):
        io.origin_at_arming[c] = origin is None
        io.origin_counts[c] = round((origin or 0.0) / description.position_scale[c])
    for name in scene.sensed:
        io[f"{name}_scale"][:channels] = description.scale(name)
    # In whole counts, so that rounding does not take a force beyond its limit, nor a count beyond 32 bits.
    scale, limit = np.array(description.force_scale), np.minimum(description.force_limit, scene.device.force_limit)
    with np.errstate(over="ignore"):
        counts = np.minimum(np.floor(limit / scale * (1.0 + 1e-12)), 2.0**31 - 1.0)
    io.force_limit[:channels] = counts * scale
    if scene.away:
        io.away_first, io.away_end = scene.away[0].channel, scene.away[-1].channel + 1
        io.away_rate = scene.rate
        io.force_limit[io.away_first : io.away_end] = io.force_limit[:channels].max()
    for hand in scene.channel_groups:
        for c, following in zip(hand, (*hand[1:], hand[0]), strict=True):
            io.to_next[c] = (following - c) % 2**64
