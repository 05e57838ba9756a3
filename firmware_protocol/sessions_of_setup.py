"""Sessions before arming and around it: PROTOCOL.md, sections 4, 7 and 8."""

from __future__ import annotations

from firmware_protocol import schema
from firmware_protocol.story import DEVICE, HOST, LOCKSTEP, Story
from firmware_protocol.vectors import frame

VELOCITY = schema.WITH_VELOCITY


def it_waits() -> Story:
    """For ticks and for five seconds, until it is asked."""
    s = Story("1", "A device that is not armed says nothing of its own accord and its force is zero.")
    s.tick().tick().passes(5_000_000)
    s.host(s.describe(schema.REG_VERSION), out=s.description(schema.REG_VERSION, 1))
    return s


def it_describes_itself() -> Story:
    """Registers of every kind, words of doubles among them."""
    s = Story("4", "**DESCRIBE** is answered by DESCRIPTION with the same number.", "four")
    for register, value in (
        (schema.REG_VERSION, schema.VERSION),
        (schema.REG_SCHEMA, schema.SCHEMA_HASH),
        (schema.REG_CHANNELS, 4),
        (schema.REG_PACINGS, 3),
        (schema.REG_RATE, 0),
        (schema.REG_RATE + 1, 0x408F4000),
        (schema.REG_MAX_WATCHDOG, 2047),
        (schema.REG_FAULT, 0),
        (schema.REG_CHANNEL + 8, 0xE826D695),
        (schema.REG_CHANNEL + 9, 0x3E112E0B),
        (schema.REG_CHANNEL + 26, 0xE2308C3A),
        (schema.REG_CHANNEL + 29, 0x40240000),
        (schema.REG_CHANNEL + 31, 0x3E45798E),
    ):
        s.host(s.describe(register), out=s.description(register, value))
    return s


def there_are_no_others() -> Story:
    """Registers between those that exist, and beyond them."""
    s = Story("4", "A register that does not exist reads 0.")
    for register in (13, 15, 20, 31, schema.REG_CHANNEL + 8, schema.REGISTERS, 4095):
        s.host(s.describe(register), out=s.description(register, 0))
    return s


def armed_it_ignores_describe() -> Story:
    """In either format."""
    s = Story("4", "An armed device ignores DESCRIBE.").arms()
    for wire in ("setup", "armed_1"):
        s.host(frame(wire, "describe", 0, 0, [0]))
    return s.tick(out=s.held(1))


def arming_is_answered() -> Story:
    """Taken, refused after DISARM, and taken again."""
    s = Story("4", "**ARM** is answered by STATUS with number 0: state *armed*, or the state as it was")
    s.arms().tick(out=s.held(1)).host(s.disarm(), out=s.status(1, "idle"), state="idle")
    s.wire = "setup"
    s.host(s.arm_frame(word=1), out=s.status(0, "idle", schema.WRONG_SCHEMA))
    return s.arms()


def armed_it_ignores_arm() -> Story:
    """In either format: the watchdog stays that of the first ARM."""
    s = Story("4", "An armed device ignores ARM.").arms(watchdog=2)
    s.host(s.answer(0, 5, lives=9)).tick(out=s.position(1), force=[5])
    for wire in ("setup", "armed_1"):
        s.host(frame(wire, "arm", 100, 0, [schema.SCHEMA_HASH]))
    return s.tick(out=s.held(2)).tick(out=s.held(3) + s.latches(3, schema.HOST_QUIET), force=[0], state="latched")


def only_the_armed_act() -> Story:
    """FORCE in either format, while idle."""
    s = Story("4", "**FORCE** is acted on by an armed device alone")
    s.host(frame("setup", "force", 0, 255, [77]), frame("armed_1", "force", 0, 255, [77])).tick()
    return s.registers(accepted=0)


def idle_it_says_where_it_stopped() -> Story:
    s = Story("4", "an idle device goes on saying the one at which it stopped.").arms()
    s.tick(out=s.held(1)).tick(out=s.held(2)).host(s.disarm(), out=s.status(2, "idle"), state="idle").tick()
    s.wire = "setup"
    return s.host(s.disarm(), out=s.status(2, "idle"))


def disarm_is_obeyed() -> Story:
    """Idle, armed, and idle again, each in the format of that state."""
    s = Story("4", "**DISARM** is obeyed in every state: force zero at once, state *idle*, set-up format, then STATUS.")
    s.host(s.disarm(), out=s.status(0, "idle")).arms()
    s.host(s.answer(0, 5, lives=9)).tick(out=s.position(1), force=[5])
    s.host(s.disarm(), out=s.status(1, "idle"), force=[0], state="idle").tick()
    s.host(s.disarm("armed_1"))  # not in this format any more
    s.wire = "setup"
    return s.host(s.disarm(), out=s.status(1, "idle"))


def disarm_takes_what_waits() -> Story:
    """A force that came in the same sample acts no more, nor after arming again."""
    s = Story("4", "**DISARM** is obeyed in every state: force zero at once", "four").arms()
    s.host(s.answer(0, 5, 6, 7, 8, lives=9), s.disarm(), out=s.status(0, "idle"), state="idle").tick()
    s.wire = "setup"
    return s.arms().tick(out=s.held(1))


def unused_fields_count_for_nothing() -> Story:
    s = Story("2", "Fields that a type does not use are sent as zero and ignored by the receiver.")
    s.host(frame("setup", "describe", 2, 99, [-1]), out=s.description(2, 1))
    s.arms().host(frame("armed_1", "disarm", 4095, 255, [-1]), out=s.status(0, "idle"), state="idle")
    return s


def types_are_refused() -> Story:
    """Those of the device, and those of nobody."""
    from firmware_protocol.frames import SETUP, frame_to_device

    s = Story("4", "All other types are unknown and are refused as errors of form.")
    s.host(*(frame_to_device(SETUP, kind, 0, 0, [0]) for kind in (0, 5, 9, 10, 15)))
    return s.registers(rejected=5)


def it_refuses() -> Story:
    """For every reason; of several, schema comes before pacing, sensing and watchdog."""
    s = Story("7", "ARM is refused, with the fault in brackets, unless", "bare")
    for argument, watchdog, word, fault in (
        (DEVICE, 100, schema.SCHEMA_HASH ^ 1, schema.WRONG_SCHEMA),
        (HOST, 100, schema.SCHEMA_HASH, schema.WRONG_PACING),
        (LOCKSTEP, 100, schema.SCHEMA_HASH, schema.WRONG_PACING),
        (3, 100, schema.SCHEMA_HASH, schema.WRONG_PACING),
        (127, 100, schema.SCHEMA_HASH, schema.WRONG_PACING),
        (DEVICE | VELOCITY, 100, schema.SCHEMA_HASH, schema.WRONG_SENSING),
        (DEVICE, 0, schema.SCHEMA_HASH, schema.WRONG_WATCHDOG),
        (DEVICE, 101, schema.SCHEMA_HASH, schema.WRONG_WATCHDOG),
        (DEVICE, 4095, schema.SCHEMA_HASH, schema.WRONG_WATCHDOG),
        (LOCKSTEP, 0, 0, schema.WRONG_SCHEMA),
        (LOCKSTEP, 0, schema.SCHEMA_HASH, schema.WRONG_PACING),
        (DEVICE | VELOCITY, 0, schema.SCHEMA_HASH, schema.WRONG_SENSING),
    ):
        s.host(s.arm_frame(watchdog, argument, word), out=s.status(0, "idle", fault)).registers(fault=fault)
        s.tick()
    return s.arms(watchdog=100).registers(fault=0)


def it_refuses_latched() -> Story:
    """The device stays latched, and says why it refused."""
    s = Story("4", "or the state as it was and the reason of the refusal as its fault.").arms(watchdog=1)
    s.tick(out=s.held(1) + s.latches(1, schema.HOST_QUIET), state="latched")
    s.host(s.arm_frame(watchdog=0), out=s.status(0, "latched", schema.WRONG_WATCHDOG))
    return s.arms()


def arming_begins_anew() -> Story:
    """After a session in which each counter counted."""
    s = Story("7", "Otherwise the device clears its fault and the counters of registers 8 to 12, counts samples from 0")
    s.arms(watchdog=3)
    s.host(s.answer(0, 2 * 10**9, lives=1)).tick(out=s.position(1), force=[10**9])
    s.host(b"\1\2\3\0" + s.answer(1000)).tick(out=s.held(2)).tick(out=s.held(3), force=[0])
    s.tick(out=s.held(4) + s.latches(4, schema.HOST_QUIET), state="latched")
    s.registers(fault=1, accepted=1, rejected=1, held=3, expired=1, limited=1)
    s.arms().registers(fault=0, accepted=0, rejected=0, held=0, expired=0, limited=0)
    return s.tick(out=s.held(1))


def every_channel() -> Story:
    """Four of them, to the ends of 32 bits."""
    s = Story(
        "6", "measures the positions, which are sample *n + 1*, and the velocities where they were asked for;", "four"
    )
    s.measures(1, -2, 2**31 - 1, -(2**31) + 1).arms().host(s.answer(0, 4, -5, 6, -7))
    s.measures(5, 6, 7, 8).tick(out=s.position(1), force=[4, -5, 6, -7])
    return s


def velocities_or_none() -> Story:
    """Armed with them, and again without."""
    s = Story("7", "Until it is armed again it measures and sends velocities with every position, or with none.")
    s.measures(11, velocities=[-500]).arms(velocity=True).host(s.answer(0, 5)).tick(out=s.position(1), force=[5])
    s.measures(12, velocities=[600]).tick(out=s.held(2), force=[0])
    s.host(s.disarm(), out=s.status(2, "idle"), state="idle")
    s.wire = "setup"
    return s.arms().tick(out=s.held(1))


def format_is_forgotten() -> Story:
    """A frame is cut off before a switch in either direction."""
    s = Story("3", "Whoever switches forgets the beginning of an unfinished frame; counters go on.")
    s.host(s.describe(0)[:5]).host(s.describe(0), out=s.description(0, 1)).registers(rejected=0)
    s.arms().host(s.answer(0, 5)[:6]).host(s.disarm(), out=s.status(0, "idle"), state="idle")
    s.wire = "setup"
    return s.host(s.describe(2), out=s.description(2, 1))


SETUP = (
    it_waits,
    it_describes_itself,
    there_are_no_others,
    armed_it_ignores_describe,
    arming_is_answered,
    armed_it_ignores_arm,
    only_the_armed_act,
    idle_it_says_where_it_stopped,
    disarm_is_obeyed,
    disarm_takes_what_waits,
    unused_fields_count_for_nothing,
    types_are_refused,
    it_refuses,
    it_refuses_latched,
    arming_begins_anew,
    every_channel,
    velocities_or_none,
    format_is_forgotten,
)
