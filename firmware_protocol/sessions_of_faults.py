"""Sessions that go wrong: watchdog, latch, damaged frames, a full transmitter. PROTOCOL.md, sections 4, 7 and 8."""

from __future__ import annotations

from firmware_protocol import schema
from firmware_protocol.story import HOST, PERIOD, Story
from firmware_protocol.vectors import frame

QUIET = schema.HOST_QUIET


def _watchdog(watchdog: int, answered: int) -> Story:
    s = Story("7", "an armed device latches with fault 1 as soon as `n - heard > watchdog`.").arms(watchdog)
    for n in range(answered):
        s.host(s.answer(n, 5, lives=255)).tick(out=s.position(n + 1), force=[5])
    last = answered + watchdog  # heard in sample answered - 1
    for n in range(answered, last - 1):
        s.tick(out=s.held(n + 1))
    s.tick(out=s.held(last) + s.latches(last, QUIET), force=[0], state="latched").registers(fault=QUIET)
    return s.tick().tick()


def watchdog_of_one() -> Story:
    """The shortest watchdog, of a host that answers once."""
    return _watchdog(1, 1)


def watchdog_of_twenty() -> Story:
    """Twenty samples, of a host that answers three times."""
    return _watchdog(20, 3)


def host_that_never_answers() -> Story:
    return _watchdog(5, 0)


def watchdog_by_the_clock() -> Story:
    """Paced by the host, 10 samples: latched 11 ms after arming, and 11 ms after the last force."""
    s = Story("7", "Paced by the host it measures the time since the last accepted FORCE, or since arming, in nominal")
    s.arms(watchdog=10, pacing=HOST).passes(10_900)
    s.passes(200, out=s.latches(0, QUIET), state="latched").passes(50 * PERIOD)
    s.arms(watchdog=10, pacing=HOST).passes(5_000).host(s.answer(0, 3, lives=255), out=s.position(1), force=[3])
    s.passes(10_900).passes(200, out=s.latches(1, QUIET), force=[0], state="latched")
    return s.passes(50 * PERIOD)


def latched_means_zero() -> Story:
    """FORCE in either format moves nothing; DESCRIBE is answered, and ARM arms again."""
    s = Story("7", "Latched means: force zero, whatever arrives, until the host arms the device again.", "four")
    s.arms(watchdog=1).host(s.answer(0, 1, 2, 3, 4, lives=255)).tick(out=s.position(1), force=[1, 2, 3, 4])
    s.tick(out=s.held(2) + s.latches(2, QUIET), force=[0] * 4, state="latched")
    s.host(frame("armed_4", "force", 2, 255, [9] * 4), frame("setup", "force", 2, 255, [9])).tick()
    s.host(s.describe(schema.REG_FAULT), out=s.description(schema.REG_FAULT, QUIET))
    return s.arms().host(s.answer(0, 1, 2, 3, 4)).tick(out=s.position(1), force=[1, 2, 3, 4])


def fault_stays_readable() -> Story:
    """In register 7 and in two STATUS, until ARM clears it."""
    s = Story("4", "The fault stays readable after DISARM (register 7, and every STATUS) until the next ARM.")
    s.arms(watchdog=1).tick(out=s.held(1) + s.latches(1, QUIET), state="latched")
    s.host(s.disarm(), out=s.status(1, "idle", QUIET), state="idle").registers(fault=QUIET)
    s.host(s.disarm(), out=s.status(1, "idle", QUIET))
    return s.arms().registers(fault=0)


def position_that_does_not_fit() -> Story:
    """The device latches instead of sending it, and again when it is armed as long as that lasts."""
    s = Story("7", "**Own fault**: a position that does not fit 32 bits (2)").arms()
    fault = schema.POSITION_OUT_OF_RANGE
    s.host(s.answer(0, 5, lives=20)).tick(out=s.position(1), force=[5]).finds(fault)
    s.tick(out=s.latches(2, fault), force=[0], state="latched").tick()
    s.wire = "armed_1"
    s.host(s.arm_frame(), out=s.status(0, "armed") + s.latches(0, fault))
    return s.finds(0).arms()


def hardware_fault() -> Story:
    """Found by the hardware while armed: latched with fault 6."""
    s = Story("7", "or anything the hardware finds (6).").arms(velocity=True)
    s.finds(schema.HARDWARE)
    return s.tick(out=s.latches(1, schema.HARDWARE), state="latched")


def damaged_frames() -> Story:
    """A flipped bit and a missing byte count as rejected; noise in front of a sound frame does not."""
    s = Story("8", "ignores and counts them").arms()
    good = s.answer(0, 5)
    s.host(good[:3] + bytes([good[3] ^ 4]) + good[4:]).registers(rejected=1)
    s.host(good[1:]).registers(rejected=2).host(b"\7\7\7", good).registers(rejected=2, accepted=1)
    return s.tick(out=s.position(1), force=[5])


def strangers() -> Story:
    """FORCE in formats of another host: refused by their start value; the sample goes unanswered."""
    s = Story("8", "refuses ARM with fault 3; armed frames are refused by their start value").arms()
    s.host(frame("velocity_1", "force", 0, 255, [9]), frame("setup", "force", 0, 255, [9]))
    return s.registers(rejected=2, accepted=0).tick(out=s.held(1))


def host_that_died() -> Story:
    """Another host asks an armed device, and is answered once the watchdog has latched it."""
    s = Story("8", "its watchdog latches it; then it answers the new host").arms(watchdog=4)
    s.host(s.answer(0, 5, lives=1)).tick(out=s.position(1), force=[5])
    s.host(s.describe(0)).tick(out=s.held(2)).host(s.describe(0)).tick(out=s.held(3), force=[0])
    s.tick(out=s.held(4)).tick(out=s.held(5) + s.latches(5, QUIET), state="latched")
    return s.host(s.describe(0), out=s.description(0, 1))


def full_transmitter() -> Story:
    """Positions and the STATUS latched that find no room are dropped; the watchdog latches all the same."""
    s = Story("6", "A frame that finds no room in the transmitter is dropped whole").arms(watchdog=3).room(False)
    s.host(s.answer(0, 5, lives=9)).tick(force=[5]).tick().room(True).tick(out=s.held(3)).room(False)
    s.latches(4, QUIET)
    s.tick(force=[0], state="latched").room(True)
    return s.host(s.describe(schema.REG_FAULT), out=s.description(schema.REG_FAULT, QUIET))


FAULTS = (
    watchdog_of_one,
    watchdog_of_twenty,
    host_that_never_answers,
    watchdog_by_the_clock,
    latched_means_zero,
    fault_stays_readable,
    position_that_does_not_fit,
    hardware_fault,
    damaged_frames,
    strangers,
    host_that_died,
    full_transmitter,
)
