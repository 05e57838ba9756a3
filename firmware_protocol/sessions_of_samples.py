"""Sessions of samples: age, time to live, limits, both clocks. PROTOCOL.md, section 6."""

from __future__ import annotations

from firmware_protocol.story import HOST, LIMIT, PERIOD, Story


def force_acts_at_the_next_tick() -> Story:
    """Four forces in time, to the limit on either side."""
    s = Story("6", "So a force that answers position *n* and arrives before tick *n + 1* acts from that tick on")
    s.arms()
    for n, force in enumerate((7, -8, LIMIT, -LIMIT)):
        s.host(s.answer(n, force)).passes(900).measures(100 + n).tick(out=s.position(n + 1), force=[force])
    return s.registers(accepted=4, held=0)


def later_one_acts() -> Story:
    """Two answers to one sample: both are accepted, and the second acts."""
    s = Story("5", "one that a later one in the same sample replaced among them")
    s.arms().host(s.answer(0, 3), s.answer(0, 4)).tick(out=s.position(1), force=[4])
    return s.registers(accepted=2, held=0)


def too_much_is_cut() -> Story:
    """To either side, up to the ends of 32 bits; what is at the limit is not counted."""
    s = Story("8", "cuts it to the limit, counts it", "four").arms()
    s.host(s.answer(0, LIMIT + 1, -LIMIT - 1, 2**31 - 1, -(2**31)))
    s.tick(out=s.position(1), force=[LIMIT, -LIMIT, LIMIT, -LIMIT]).registers(limited=4)
    s.host(s.answer(1, LIMIT, -LIMIT, 0, 1)).tick(out=s.position(2), force=[LIMIT, -LIMIT, 0, 1])
    return s.registers(limited=4)


def _lives(lives: int) -> Story:
    s = Story("6", "A force that answers sample *a* with time to live *t* acts at most from tick *a + 1* to tick")
    s.arms().host(s.answer(0, 9, lives=lives)).tick(out=s.position(1), force=[9])
    for n in range(1, lives + 1):
        s.tick(out=s.held(n + 1))
    s.tick(out=s.held(lives + 2), force=[0])
    s.host(s.answer(lives + 2, 8)).tick(out=s.position(lives + 3), force=[8])
    return s.registers(accepted=2, held=lives + 1, expired=0)


def lives_for_its_sample() -> Story:
    """Time to live 0: one sample."""
    return _lives(0)


def lives_for_two() -> Story:
    """Time to live 1: two samples."""
    return _lives(1)


def lives_for_ten() -> Story:
    """Time to live 9: ten samples."""
    return _lives(9)


def late_but_alive() -> Story:
    """A force two samples old with time to live 2 acts for the one that is left."""
    s = Story("6", "POSITION_HELD n** says: during sample *n - 1* no force arrived that answers position *n - 1*.")
    s.arms().tick(out=s.held(1)).tick(out=s.held(2))
    s.host(s.answer(0, 6, lives=2)).tick(out=s.held(3), force=[6])
    s.tick(out=s.held(4), force=[0])
    return s.registers(accepted=1, held=4, expired=0)


def too_old() -> Story:
    """It does not feed the watchdog, which latches."""
    s = Story(
        "6", "if (age > time_to_live) { expired++; return; }      /* not acted on, and it does not feed the watchdog"
    )
    s.arms(watchdog=2).tick(out=s.held(1)).host(s.answer(0, 6)).tick(out=s.held(2) + s.latches(2, 1), state="latched")
    return s.registers(accepted=0, expired=1, held=2)


def from_the_future() -> Story:
    """By one sample, and by half of the numbers."""
    s = Story(
        "6", "0 is a force in time; 1 one that answers the position before; a force from the future reads as 4095."
    )
    s.arms().host(s.answer(1, 6, lives=255), s.answer(2048, 6, lives=255)).tick(out=s.held(1))
    return s.registers(accepted=0, expired=2)


def _after(samples: int, says: str) -> Story:
    """A session that begins `samples` samples after arming. Nobody reads what is said meanwhile: it is not sent."""
    s = Story("6", says).arms(watchdog=2047).room(False)
    for n in range(0, samples, 2000):
        s.host(s.answer(n, 1)).tick(force=[0], times=min(2000, samples - n))
    return s.room(True)


def numbers_wrap() -> Story:
    s = _after(4095, "On the wire a number has 12 bits.")
    s.host(s.answer(4095, 2)).tick(out=s.position(4096), force=[2])
    s.host(s.answer(4096, 3)).tick(out=s.position(4097), force=[3])
    return s.registers(expired=0)


def ages_across_the_wrap() -> Story:
    s = _after(4200, "The *age* of a FORCE at the device is `(n - number) mod 4096`")
    s.host(s.answer(4000, 5, lives=200)).tick(out=s.held(4201), force=[5])
    return s.tick(out=s.held(4202), force=[0]).host(s.answer(4202 - 201, 5, lives=200)).registers(expired=1)


def host_makes_the_tick() -> Story:
    """However long it takes, and twice where two forces come together."""
    s = Story("6", "the device answers it with the next position; the sample lasts as long as the host takes")
    s.arms(pacing=HOST).passes(300)
    s.host(s.answer(0, 5), out=s.position(1), force=[5]).passes(400).measures(77)
    s.host(s.answer(1, 6), out=s.position(2), force=[6])
    s.host(s.answer(2, 7), s.answer(3, 8), out=s.position(3) + s.position(4), force=[8])
    return s.registers(accepted=4, held=0)


def host_asks_again() -> Story:
    """The same force makes another tick, until it is too old."""
    s = Story("6", "paced by the host, it sends that answer again, which asks for the next position.")
    s.arms(pacing=HOST).host(s.answer(0, 5, lives=3), out=s.position(1), force=[5])
    s.host(s.answer(0, 5, lives=3), out=s.held(2))
    s.host(s.answer(0, 5, lives=1)).registers(expired=1, held=1, accepted=2)
    return s


def host_clock_time_to_live() -> Story:
    """By the device's clock: zero after t + 1 periods; the next force acts as ever."""
    s = Story("6", "once more than *t + 1* nominal sample periods have passed since the last accepted FORCE.")
    s.arms(pacing=HOST, watchdog=100).host(s.answer(0, 5, lives=3), out=s.position(1), force=[5])
    s.passes(4 * PERIOD).passes(1, force=[0]).passes(50 * PERIOD)
    s.host(s.answer(1, 6, lives=0), out=s.held(2), force=[6]).registers(held=1, accepted=2)
    s.passes(PERIOD).passes(1, force=[0]).host(s.answer(2, 7, lives=255), out=s.held(3), force=[7])
    s.host(s.answer(3, 8, lives=255), out=s.position(4), force=[8])  # late was the one after the lapse, and no other
    s.passes(100 * PERIOD).passes(PERIOD, out=s.latches(4, 1), force=[0], state="latched")
    return s.registers(held=2)


def impulses_are_not_repeated() -> Story:
    """A device whose actuator gives impulses, with forces that might live on."""
    s = Story("6", "gives each accepted force once and does not repeat", "impulse").arms()
    s.host(s.answer(0, 9, lives=20)).tick(out=s.position(1), force=[9]).tick(out=s.held(2), force=[0])
    return s.host(s.answer(1, 8, lives=20)).tick(out=s.held(3), force=[8]).tick(out=s.held(4), force=[0])


SAMPLES = (
    force_acts_at_the_next_tick,
    later_one_acts,
    too_much_is_cut,
    lives_for_its_sample,
    lives_for_two,
    lives_for_ten,
    late_but_alive,
    too_old,
    from_the_future,
    numbers_wrap,
    ages_across_the_wrap,
    host_makes_the_tick,
    host_asks_again,
    host_clock_time_to_live,
    impulses_are_not_repeated,
)
