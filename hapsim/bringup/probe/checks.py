"""Every check of a device: its name, its step, the section of PROTOCOL.md that it stands for, and what is expected; and
what was found.

The steps come in the order in which a firmware is brought up; so do the checks in each of them.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from firmware_protocol import schema
from firmware_protocol.description import Description
from hapsim.bringup.probe.wire import Session, Wire, arm, told

Result = Literal["pass", "FAIL", "not seen"]

SECTIONS = {
    "1": "A session",
    "2.3": "The check",
    "2.5": "Reading",
    "3": "Formats",
    "4": "Frames",
    "5": "Registers",
    "6": "Samples, age, and what the device does at a tick",
    "7": "Arming and releasing",
    "8": "What each side does when the other is ...",
    "10": "Counters",
    "11": "Time on the wire",
}
"""The titles of PROTOCOL.md that a check stands for."""


@dataclass(frozen=True)
class Declared:
    """A check, before anything was seen of it."""

    name: str
    step: str
    section: str
    expected: str


def _of(step: str, *checks: tuple[str, str, str]) -> tuple[Declared, ...]:
    return tuple(Declared(name, step, section, expected) for name, section, expected in checks)


CHECKS = (
    *_of(
        "conversation",
        ("answers", "8", "an answer to DESCRIBE within 3 s"),
        ("describe", "4", "DESCRIPTION with the number of the register that was asked for"),
        ("silence", "1", "a device that is not armed says nothing of its own accord"),
        ("damaged_frames", "2.3", "a frame with a flipped bit is not answered, the next whole one is"),
        ("finding_back", "2.5", "the next whole frame is answered, after noise and in any pieces"),
        ("unknown_types", "4", "a type that is unknown, and FORCE while not armed, is not answered"),
        ("unknown_registers", "5", "a register that does not exist reads 0"),
    ),
    *_of(
        "registers",
        ("version", "5", "register 0 holds 1"),
        ("schema", "5", "register 1 holds the schema hash of this hapsim"),
        ("channels", "5", "register 2 holds 1 to 16"),
        ("pacings", "5", "register 3: bit 0 (device), bit 1 (host), bit 2 (lockstep), at least one, no other"),
        ("lockstep", "7", "no device with a motor declares lockstep: it is for simulated devices only"),
        ("rate", "5", "registers 4 and 5 hold a finite number of Hz above 0"),
        ("max_watchdog", "5", "register 6 holds 1 to 2047 samples"),
        ("name", "5", "registers 16 to 19 hold printable ASCII, padded with zeros"),
        ("position_scale", "5", "finite and above 0, m per count, on every channel"),
        ("force_scale", "5", "finite and above 0, N per count, on every channel"),
        ("force_limit", "5", "finite and above 0, N, on every channel, and within 32 bits of counts"),
        ("velocity_scale", "5", "above 0 on every channel where velocity is sensed, 0 on all where it is not"),
    ),
    *_of(
        "refusals",
        ("wrong_schema", "7", "ARM with another schema hash: STATUS number 0, idle, fault 3"),
        ("wrong_pacing", "7", "ARM with a pacing that register 3 does not declare: STATUS number 0, idle, fault 4"),
        ("wrong_watchdog", "7", "ARM with watchdog 0, or above register 6: STATUS number 0, idle, fault 5"),
        ("wrong_sensing", "7", "ARM with velocities where none is sensed: STATUS number 0, idle, fault 7"),
        ("stays_idle", "7", "after a refusal the device is as it was: it sends no position and answers DESCRIBE"),
        ("disarm_idle", "4", "DISARM answered with STATUS idle in the set-up format; the last fault stays readable"),
    ),
    *_of(
        "arming",
        ("arm", "7", "ARM answered with STATUS number 0, armed, fault 0, in the set-up format"),
        ("first_position", "7", "then POSITION 0, in the armed format"),
        ("numbers", "6", "the numbers of the positions go up by one"),
        ("rate_kept", "6", "samples at the rate of register 4, within 1 %"),
        ("jitter", "6", "sent at once at each tick (arrival by the host's wall clock, for information)"),
        ("ignores_when_armed", "4", "an armed device ignores ARM and DESCRIBE, and goes on"),
        ("disarm_armed", "4", "DISARM answered with STATUS idle in the set-up format, and no position after it"),
        ("velocities", "3", "armed with velocities: positions in that format, each with its velocities"),
    ),
    *_of(
        "forces",
        ("in_time", "6", "a sample that was answered in time ends with POSITION, not POSITION_HELD"),
        ("withheld", "6", "a sample that was not answered ends with POSITION_HELD"),
        ("accepted", "5", "register 8 counts the FORCE frames that were acted on since arming"),
        ("rejected", "10", "register 9 counts the damaged frames since arming"),
        ("held", "5", "register 10 counts the samples that ended without their answer: the POSITION_HELD"),
        (
            "expired",
            "6",
            "a FORCE older than its time to live, or from the future, is not acted on; register 11 counts",
        ),
        ("not_limited", "5", "register 12 counts no force where all were zero"),
        ("age", "6", "age of the acting force at each tick: 1 where every answer was in time (for information)"),
    ),
    *_of(
        "watchdog",
        ("latches", "7", "latches as soon as no FORCE was accepted for more samples than the watchdog"),
        ("latched_status", "7", "STATUS latched, fault 1, in the armed format; then the set-up format"),
        ("latched_ignores", "7", "a latched device ignores FORCE, sends nothing and answers DESCRIBE"),
        ("disarm_latched", "4", "DISARM answered with STATUS idle in the set-up format, and fault 1 kept"),
        ("rearming", "7", "arming clears the fault and the counters and counts from 0 again, idle or latched before"),
    ),
    *_of(
        "blocked",
        ("tick_goes_on", "8", "the samples go on while the host does not read; their numbers show the gap"),
        ("whole_frames", "2.5", "what finds no room is dropped as whole frames: nothing torn arrives"),
        ("watchdog_blocked", "8", "the watchdog latches a device whose host neither reads nor writes"),
    ),
    *_of(
        "host",
        ("no_own_tick", "6", "paced by the host no sample ends by itself"),
        ("each_force", "6", "paced by the host each FORCE is answered by the next POSITION"),
        ("same_force_again", "6", "a FORCE that is sent again asks for the next position, which is held"),
        ("round_trip", "11", "from FORCE to position, by the host's wall clock (for information)"),
        ("host_watchdog", "7", "latches when no FORCE came for watchdog nominal periods, by the device's own clock"),
    ),
    *_of(
        "push",
        ("sign", "6", "a positive force accelerates towards larger positions"),
        ("delay", "6", "a force that answers sample n acts from tick n + 1 on: not before, and not a sample later"),
        ("mass", "5", "force over acceleration, in the scales of the registers, is the mass that was given"),
        ("time_to_live", "6", "a force with time to live t acts for t + 1 samples, and then it is zero"),
        ("limit_cut", "5", "a force above the limit is cut to it; register 12 counts each"),
        ("host_time_to_live", "6", "paced by the host a force is zero t + 1 nominal periods after it came"),
    ),
)

STEPS = tuple(dict.fromkeys(one.step for one in CHECKS))

DECLARED = {one.name: one for one in CHECKS}


@dataclass(frozen=True)
class Check:
    """What became of a check."""

    name: str
    step: str
    section: str
    title: str
    result: Result
    found: str
    expected: str
    look_at: str
    """What to look at; empty where nothing is wrong."""


class Findings:
    """What was found so far; a check that was not reached is not seen."""

    def __init__(self) -> None:
        self._made: dict[str, Check] = {}

    def passed(self, name: str, found: str) -> None:
        """Unless the check has failed already."""
        if not self.has_failed(name):
            self._note(name, "pass", found, "")

    def failed(self, name: str, found: str, look_at: str) -> None:
        """The first failure of a check stays: what comes after it may follow from it."""
        if not self.has_failed(name):
            self._note(name, "FAIL", found, look_at)

    def not_seen(self, name: str, why: str, look_at: str = "") -> None:
        if name not in self._made:
            self._note(name, "not seen", why, look_at)

    def judge(self, name: str, kept: bool, found: str, look_at: str) -> bool:
        """Passed or failed by `kept`, which is returned."""
        if kept:
            self.passed(name, found)
        else:
            self.failed(name, found, look_at)
        return kept

    def found(self, name: str) -> str:
        """What was found so far of a check; empty where nothing was."""
        return self._made[name].found if name in self._made else ""

    def has_failed(self, name: str) -> bool:
        return name in self._made and self._made[name].result == "FAIL"

    def failed_next(self, step: str, found: str, look_at: str) -> None:
        """The first check of a step of which nothing was found failed."""
        for one in CHECKS:
            if one.step == step and one.name not in self._made:
                self.failed(one.name, found, look_at)
                return

    def leave_out(self, step: str, why: str) -> None:
        """Whatever was not seen of a step is not seen, for this reason."""
        for one in CHECKS:
            if one.step == step:
                self.not_seen(one.name, why)

    def all_of(self, steps: tuple[str, ...] = STEPS) -> tuple[Check, ...]:
        """Every check of these steps, in order."""
        for step in steps:
            self.leave_out(step, "not reached")
        return tuple(self._made[one.name] for one in CHECKS if one.step in steps)

    def _note(self, name: str, result: Result, found: str, look_at: str) -> None:
        declared = DECLARED[name]
        title = SECTIONS[declared.section]
        self._made[name] = Check(
            name, declared.step, declared.section, title, result, found, declared.expected, look_at
        )


@dataclass(frozen=True)
class Leave:
    """The user's leave to push, on one channel."""

    force: float
    """N at most, to either side."""
    travel: float
    """m at most, from where the pushing began."""
    channel: int = 0
    mass: float | None = None
    """kg, with the hand, where the user knows it."""


class Probing(Findings):
    """A device that is being judged: its wire, what it said of itself, what the user allows, and what was found."""

    def __init__(self, wire: Wire, leave: Leave | None = None) -> None:
        super().__init__()
        self.wire, self.leave = wire, leave
        self.description: Description | None = None
        self.steady = True
        """Whether the device kept its rate while the host did not read, as far as that can be seen."""
        self.response: float | None = None
        """m/s² per N, as the pushes found it."""

    @property
    def device(self) -> Description:
        """What the device said of itself, once that is known to make sense."""
        assert self.description is not None, "no step that arms comes before the registers"
        return self.description

    @property
    def longest_watchdog(self) -> int:
        return self.device.max_watchdog_samples

    def periods(self, samples: float) -> float:
        """In s."""
        return samples / self.device.rate_hz

    def samples_in(self, seconds: float, least: int, most: int) -> int:
        return min(max(round(seconds * self.device.rate_hz), least), most)

    def arm(self, pacing: int, watchdog: int, *, velocity: bool = False) -> Session | None:
        """None, and not armed, where the device did not take it."""
        session = arm(self.wire, self.device.rate_hz, pacing, watchdog, velocity=velocity)
        if session.status is not None and session.status.state == schema.ARMED:
            return session
        self.wire.release()
        return None

    def arm_by_device(self, step: str, watchdog: int, *, velocity: bool = False) -> Session | None:
        """Armed and paced by itself; else nothing of this step is seen."""
        if not self.device.paces(schema.PACED_BY_DEVICE):
            self.leave_out(step, "the device does not declare that it paces (bit 0 of register 3)")
            return None
        session = self.arm(schema.PACED_BY_DEVICE, watchdog, velocity=velocity)
        if session is None:
            self.leave_out(step, "the device did not arm")
        return session


def status_found(session: Session | None) -> str:
    return told(session.status if session is not None else None)
