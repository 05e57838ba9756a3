"""Assembles a loop for a scene and a device: all the memory that it works on, allocated once and touched once."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from firmware_protocol.compiled import new_record
from firmware_protocol.description import Description
from firmware_protocol.frames import armed_format, framing_of
from hapsim.compiling.native import address_of
from hapsim.cordis.program import Program, compile_scene
from hapsim.cordis.stored_energy import StoredEnergy
from hapsim.device.connection import Connection
from hapsim.loop.crossfade import cross_fade
from hapsim.loop.exchange import DEVICE_CLOCK, HOST_CLOCK, LOOP, NO_CLOCK
from hapsim.loop.force_history import ForceHistory
from hapsim.loop.guards.energy_guard import EnergyGuard
from hapsim.loop.guards.sign import judge_signs
from hapsim.loop.guide import set_guide
from hapsim.loop.posted import Posts
from hapsim.loop.ring import Ring, row_type
from hapsim.loop.sound import SoundRing, hear
from hapsim.loop.transport import Transport
from hapsim.prediction import surely_shaken_by, timing
from hapsim.prediction.correction import rendered
from hapsim.prediction.force_bounds import SIGN_RATE_HZ, force_bounds
from hapsim.running.correction import LoopCorrection
from hapsim.running.guard_setup import energy_guard_of, history_of, set_frozen_sensor, set_leap, set_slew, set_travel
from hapsim.running.options import Excitation, PeriodicExcitation, RunOptions
from hapsim.scene import Scene
from hapsim.sound.play import SoundOutput

if TYPE_CHECKING:
    from hapsim.device.mock.stand_ins import LiveHand

_RING_ROWS = 1 << 16
_SOUND_S, _LEAST_FRAMES = 1.0, 4096  # that the sound's ring holds at least
_CLOCK = {"device": DEVICE_CLOCK, "host": HOST_CLOCK, "lockstep": NO_CLOCK}
_FOREVER_NS = 1 << 62
_GRACE_NS = 50_000_000  # a run may end so late before the clock ends it


class LoopMemory:
    """A loop that is ready to run, with everything that has to stay in memory meanwhile."""

    def __init__(self, connection: Connection, description: Description, velocity: bool, clock: str) -> None:
        """`clock`: the device's, as in a scene."""
        self.record = new_record(LOOP)
        """LOOP of hapsim.loop.exchange."""
        self.inbox = connection.inbox
        self.wire = armed_format(description.channels, velocity)
        """The format that an armed device speaks."""
        rows = row_type(description.channels, velocity, clock == "host")
        self.ring = Ring(self.record.ring, rows, _RING_ROWS, waits=clock == "lockstep")
        self.record.inbox = address_of(self.inbox)
        self.record.slot.address = address_of(self.record.slot)
        self.record.io.address = address_of(self.record.io)
        self.record.framing = framing_of(self.wire, to_device=True)
        self.watchdog_samples = 0
        """Samples without a force after which the device releases."""
        self.first_late = ""
        """How late the first forces may be, and why, if most of them are and the scene is unstable then."""
        self.rendered_scene: Scene
        """The scene that the loop moves: the newest one, corrected."""
        self.correction: LoopCorrection | None = None
        """The rest of the correction: predictors and the estimate of the mass."""
        self.sound: SoundRing | None = None
        """What the scene's pick-ups hear; None where it has none."""
        self.sound_output: SoundOutput | None = None
        """What becomes of it; None where it goes nowhere."""
        self.excitation: Excitation | PeriodicExcitation | None = None
        """Kept here because the loop reads the forces of a periodic one."""
        self.history: ForceHistory | None = None
        """The forces that acted; None if no guard needs them."""
        self.energy_guard: EnergyGuard | None = None
        """None where it is off."""
        self.hand: LiveHand | None = None
        """The hand that holds the mock; None where the device is no mock of this process."""
        self._programs: list[Program] = []
        self._changes_before = 0

    @property
    def program(self) -> Program:
        """The program of the newest scene."""
        return self._programs[-1]

    def account_for(self, program: Program, scene: Scene) -> None:
        """Accounts for the energy of live changes to `program`, of `scene`, if the energy guard is on."""
        if self.energy_guard is not None:
            limit = float(self.record.io.force_limit[: self.wire.channels].max())
            program.stored = StoredEnergy(program, scene, self.energy_guard.tank, limit)

    def begin_with(self, program: Program) -> None:
        """Sets the program that the loop moves from the first tick on."""
        self._programs = [program]
        self.record.slot.program = program.address

    def follow_with(self, program: Program, steps: int, posts: Posts) -> None:
        """Adds a crossfade to `program`, which `take_over_from` has prepared, over this number (>= 1) of steps of the
        scene, to what is posted next."""
        if self.is_replacing:
            raise ValueError("the crossfade before is not over")
        self._changes_before += sum(int(left.record.parameters.sets) for left in self._programs[:-1])
        self._programs = [self.program, program]
        posts.add(self.record.slot, "posted_steps", steps)
        posts.add(self.record.slot, "posted", program.address)
        posts.add(self.record.slot, "cross_fade", cross_fade.address())

    def hear_with(self, scene: Scene, waits: bool) -> None:
        """Has the loop write what the scene's pick-ups hear into a ring; `waits`: and wait for who drains it."""
        record, channels = self.record.sound, len(scene.sound)
        capacity = 1 << math.ceil(math.log2(max(_SOUND_S * scene.step_rate, _LEAST_FRAMES)))
        self.sound = SoundRing(record, channels, capacity, waits)
        highpass = np.array([one.highpass for one in scene.sound.values()])
        record.keeps[:channels] = np.exp(-2.0 * np.pi * highpass / scene.step_rate)
        self.record.slot.sound, self.record.slot.hear = record.address, hear.address()

    @property
    def is_replacing(self) -> bool:
        """Whether a crossfade to another scene is under way."""
        return len(self._programs) > 1 and bool(self.record.slot.cross_fade)

    @property
    def changes(self) -> int:
        """How many sets of live parameters the loop has taken."""
        return self._changes_before + sum(int(program.record.parameters.sets) for program in self._programs)

    @property
    def control(self) -> Any:
        """What the session asks of the loop: its CONTROL record."""
        return self.record.control

    @property
    def state(self) -> Any:
        """What the loop reports: its STATE record."""
        return self.record.state


def assemble_loop(
    scene: Scene, connection: Connection, description: Description, options: RunOptions | None = None
) -> LoopMemory:
    """Returns the loop of `scene` over `connection`, not yet armed. It uses the options `duration`, `excitation`,
    `judges_energy`, `judges_sign`, `sound_file` and `unstable`."""
    options = options or RunOptions()
    rendering = rendered(scene)
    loop = LoopMemory(connection, description, bool(scene.sensed_links), scene.device.clock)
    if isinstance(connection.transport, Transport):
        loop.inbox.transport = connection.transport.record
    loop.rendered_scene = rendering.scene
    loop.begin_with(compile_scene(rendering.scene))
    if scene.sound:
        loop.hear_with(scene, options.sound_file is not None and scene.device.clock == "lockstep")
    loop.record.slot.substeps, loop.record.slot.mean = scene.substeps, scene.device.decimation == "mean"
    _set_io(loop.record.io, scene, description)
    _set_control(loop.control, scene, options.duration)
    loop.excitation = options.excitation
    if options.excitation is not None:
        _set_excitation(loop.record, options.excitation, scene)
    loop.correction = LoopCorrection(loop.record, rendering, description)
    loop.watchdog_samples = timing.watchdog_samples(scene.rate, description.max_watchdog_samples)
    _set_guards(loop, scene, connection, description, options)
    if connection.mock is not None:
        from hapsim.device.mock.stand_ins import LiveHand

        loop.hand = LiveHand(connection.mock, scene)
    loop.account_for(loop.program, rendering.scene)
    return loop


def _set_guards(
    loop: LoopMemory, scene: Scene, connection: Connection, description: Description, options: RunOptions
) -> None:
    record = loop.record
    record.watch.judges = scene.device.clock == "device" and connection.behind_port
    set_leap(record.leap, scene, description)
    set_travel(record.travel, scene, description)
    limit = float(record.io.force_limit[: description.channels].max())
    in_hand = connection.behind_port and scene.device.clock != "lockstep"  # no hand lives in virtual time
    bounds = force_bounds(scene, in_hand=in_hand, judges_energy=options.judges_energy, force_limit=limit)
    set_slew(record, scene, description, bounds)
    loop.energy_guard = energy_guard_of(record, scene, bounds)
    if options.unstable and loop.energy_guard is not None:
        loop.energy_guard.follow(unstable=surely_shaken_by(scene) is not None)
    samples = timing.samples_if_late(scene, connection.round_trip_s)
    if options.unstable is False and surely_shaken_by(timing.with_wire_delay(scene, samples)) is not None:
        loop.control.first_ticks = timing.FIRST_SAMPLES
        loop.first_late = timing.why_late(scene, samples, connection.round_trip_s)
    if (in_hand or options.judges_sign) and scene.rate >= SIGN_RATE_HZ:
        judge_signs(record.sign, rate_hz=scene.rate, masses=scene.device.mass_spans(description.channels))
    if in_hand or options.judges_energy:
        set_frozen_sensor(record, scene, description, bounds)
    if loop.energy_guard is not None or record.sign.judge or record.frozen_sensor.judge:
        loop.history = history_of(record, scene)


def _set_control(control: Any, scene: Scene, duration: float | None) -> None:
    virtual = scene.device.clock == "lockstep"
    control.samples = -1 if duration is None else max(1, round(duration * scene.rate))
    control.lasts_ns = _FOREVER_NS
    if duration is not None and not virtual:
        control.lasts_ns = min(round(duration * 1e9) + _GRACE_NS, _FOREVER_NS)
    control.go = 1
    control.wire_samples = timing.samples_on_wire(scene)
    control.period_ns = round(1e9 / scene.rate)
    control.clock = _CLOCK[scene.device.clock]
    # In virtual time the mock may live in a process that still compiles.
    control.silence_ns = round(1e9 * (5.0 if virtual else max(0.25, 20.0 / scene.rate)))
    control.time_to_live = timing.time_to_live_samples(scene.rate)
    control.stale_ns = _stale_ns(scene, control)


def _stale_ns(scene: Scene, control: Any) -> int:
    """Returns the age (ns) above which no force answers a position. In virtual time no time passes."""
    return _FOREVER_NS if scene.device.clock == "lockstep" else (int(control.time_to_live) + 1) * int(control.period_ns)


def _set_excitation(record: Any, excitation: Excitation | PeriodicExcitation, scene: Scene) -> None:
    control = record.control
    control.pulse_channel = excitation.channel
    if isinstance(excitation, PeriodicExcitation):
        control.periodic, control.periodic_length = address_of(excitation.forces), excitation.forces.size
        return
    control.pulse_force, control.pulse_ticks = excitation.force, excitation.ticks
    control.pulse_every, control.pulse_from, control.pulse_first = excitation.every, excitation.start, excitation.first
    if (guide := excitation.guide) is not None:
        channel, ticks = excitation.channel, guide.ticks(scene.rate)
        control.pulse_begin = excitation.ticks_before(scene.rate)
        mass = scene.device.masses(scene.channels)[channel]
        set_guide(
            record.guide,
            channel=channel,
            target=guide.target,
            beyond=guide.beyond,
            ticks=ticks,
            rate_hz=scene.rate,
            stiffness=guide.stiffness,
            mass=mass,
        )


def _set_io(io: Any, scene: Scene, description: Description) -> None:
    channels = description.channels
    io.channels = channels
    io.velocities = bool(scene.sensed_links)
    io.position_scale[:channels] = description.position_scale
    io.force_scale[:channels] = description.force_scale
    for c, origin in enumerate(scene.device.origins(scene.channels)):
        io.origin_at_arming[c] = origin is None
        io.origin_counts[c] = round((origin or 0.0) / description.position_scale[c])
    if scene.sensed_links:
        io.velocity_scale[:channels] = description.velocity_scale
    # In whole counts, so that rounding does not take a force beyond its limit, nor a count beyond 32 bits.
    scale, limit = np.array(description.force_scale), np.minimum(description.force_limit, scene.device.force_limit)
    with np.errstate(over="ignore"):
        counts = np.minimum(np.floor(limit / scale * (1.0 + 1e-12)), 2.0**31 - 1.0)
    io.force_limit[:channels] = counts * scale
