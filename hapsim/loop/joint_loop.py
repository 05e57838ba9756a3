"""The loop of a scene with several ports: one thread, which answers each port when its position comes.

Each port has a LOOP of its own, as a scene of one device has: program, guards, record, counts, time to live. What ties
them are the points of other ports (away.py). Four clocks, of which all ports have the same:

* the devices: the loop waits for all descriptors, and takes the positions in the order in which they were sampled, by
  the clocks of their ports. So a stall, after which many are there at once, changes no age. A port is answered once its
  newest position is taken.
* none, in virtual time: the port whose next sample is the earliest goes on.
* the host's, with mocks in memory: likewise, each at its time.
* the host's, with devices: one grid paces all. The positions of one tick are answered together, so that they have one
  age, 0.

Until all ports have sent a first position, a device that paces is answered with zero force.

If a port fails, the loop releases the others: their forces ramp to zero over RELEASE samples of a force's time to live,
and then they are disarmed, at the latest after the time to live. If a run ends as asked, all are disarmed at once.
"""

from __future__ import annotations

import numpy as np

from firmware_protocol import schema
from firmware_protocol.decoder import next_frame
from hapsim.compiling import entry, helper, inlined
from hapsim.compiling.native import record_at
from hapsim.loop.away import MOST_PORTS, PORT, locate_points, publish_hands, publish_masses
from hapsim.loop.buffers import AT_ONCE, inbox_at, next_place, scale_force
from hapsim.loop.clocks import SLICE_NS, next_point, sleep_to
from hapsim.loop.compiled_loop import send_frame
from hapsim.loop.endings import (
    DONE,
    OTHER_PORT,
    RING_FULL,
    RUNNING,
    SILENT,
    STOPPED,
    TIMED_OUT,
    ending_before_exchange,
)
from hapsim.loop.exchange import DEVICE_CLOCK, HOST_CLOCK, LOOP, MEMORY_CLOCK, NO_CLOCK, on_force_sent, take_frame
from hapsim.loop.histogram import note
from hapsim.loop.hooks import Hook, Stage, hook, io_at, tick_at
from hapsim.loop.port_clock import advance_clock
from hapsim.loop.ring import FADED
from hapsim.loop.system import (
    SCRATCH,
    flush_denormals,
    has_news,
    now_ns,
    restore_denormals,
    sleep_until,
    wait_for_any,
)
from hapsim.loop.transport import receive

RELEASE = 0.5  # of a force's time to live

_MODULUS_MASK = schema.SAMPLE_MODULUS - 1
_NOTHING, _FORCE, _DISARM = range(3)  # what is to be sent
_NEVER = 1 << 62

JOINT = np.dtype(
    [
        ("count", np.int64),  # of ports
        ("clock", np.int64),  # of all, one of exchange.py
        ("begun", np.int64),  # 1: the first positions of all are known
        ("disarms", np.int64),  # 1: a port has just ended
        ("begun_ns", np.int64),  # real time of virtual time 0, for mocks in memory
        ("due_ns", np.int64),  # where the host paces: the next tick,
        ("tick_ns", np.int64),  # and when the loop woke up for the last
        ("polled", np.int64, (MOST_PORTS,)),
        SCRATCH,
        ("ports", PORT, (MOST_PORTS,)),
    ],
    align=True,
)
"""Memory of the loop of several ports."""

_loop_at, _port_at = record_at(LOOP), record_at(PORT)


@entry
def run_loops(joint):
    """Runs exchanges of all ports of a JOINT until all have ended. Returns DONE, and each port's `ending` has a code of
    endings.py; or RING_FULL, which leaves all devices armed: the caller makes room and calls again."""
    mode = flush_denormals()
    now = now_ns(joint.scratch)
    for p in range(np.uint64(joint.count)):
        joint.ports[p].heard_ns = now
    ending = RUNNING
    while True:
        _send(joint, now)
        if ending != RUNNING:
            break
        ending = _end_ports(joint, now)
        if ending != RUNNING or joint.disarms:
            continue
        _receive(joint, now)
        now = now_ns(joint.scratch)
        if not joint.begun:
            joint.begun = _greet(joint, now)
        elif joint.clock == HOST_CLOCK:
            _exchange_on_grid(joint, now)
        else:
            _exchange_earliest(joint)
    restore_denormals(mode)
    return ending


# Endings


@inlined
def _end_ports(joint, now):
    """Finds which ports end, and what that means for the others. Returns RUNNING, DONE, RING_FULL."""
    running, failed, over = 0, False, RUNNING
    joint.disarms = 0
    for p in range(np.uint64(joint.count)):
        port = joint.ports[p]
        code = port.ending if port.ending != RUNNING else _ending_of(port, now)
        if code == RING_FULL:
            return RING_FULL
        if code == RUNNING:
            running += 1
        else:
            _end(joint, port, code)
            failed = failed or code not in (DONE, STOPPED)
            over = code if code in (DONE, STOPPED) else over
    for p in range(np.uint64(joint.count)):
        port = joint.ports[p]
        if port.ending == RUNNING and over != RUNNING:
            _end(joint, port, over)
        elif port.ending == RUNNING and failed and not port.releases:
            _release(port, now, joint.begun)
    return RUNNING if running > 0 and over == RUNNING else DONE


@inlined
def _ending_of(port, now):
    """Returns RUNNING, RING_FULL, or the code with which a port ends before its next exchange."""
    loop = _loop_at(port.loop)
    code = ending_before_exchange(loop)
    if code == RUNNING and _is_awaited(port) and now - port.heard_ns > loop.control.silence_ns:
        return SILENT
    return OTHER_PORT if code == RUNNING and port.releases and now > port.release_by_ns else code


@inlined
def _end(joint, port, code):
    """Ends a port with this code, once: its device is disarmed."""
    if not port.ended:
        port.ended, port.ending, port.sends = 1, code, _DISARM
        joint.disarms = 1


@inlined
def _release(port, now, begun):
    """Lets the force of a port ramp to zero."""
    control = _loop_at(port.loop).control
    port.releases, port.ramp = 1, max(RELEASE * control.time_to_live, 1.0)
    port.release_by_ns = now + control.time_to_live * control.period_ns if begun else now
    if control.clock == NO_CLOCK and begun:
        port.release_by_ns = _NEVER


@hook
def release(port, tick):
    """Lowers the force of a port along its ramp. Returns OTHER_PORT at its end, else 0."""
    port, tick = _port_at(port), tick_at(tick)
    if not port.releases:
        return 0
    io = io_at(tick.io)
    port.released += tick.gap
    left = max(1.0 - port.released / port.ramp, 0.0)
    for c in range(np.uint64(io.channels)):
        scale_force(io, c, left)
    tick.flags |= FADED
    return OTHER_PORT if left == 0.0 else 0


def release_hook(port: object) -> Hook:
    """Returns the hook of a PORT that releases it if another one fails."""
    return Hook(Stage.LOWER, release, port)


# Sending


@inlined
def _send(joint, now):
    """Sends to each port what is to be sent."""
    for p in range(np.uint64(joint.count)):
        port = joint.ports[p]
        if port.sends == _NOTHING:
            continue
        loop, disarms = _loop_at(port.loop), port.sends == _DISARM
        port.sends = _NOTHING
        loop.wait.begun_ns = joint.tick_ns if joint.clock == HOST_CLOCK else now
        if joint.clock == HOST_CLOCK and loop.state.unanswered:
            loop.state.tick_ns = loop.wait.begun_ns  # not for a repeated request
        code = send_frame(loop, disarms)
        if disarms:
            continue
        if loop.state.ticks > 0:
            on_force_sent(loop, loop.state.newest_ns if joint.clock == NO_CLOCK else now_ns(joint.scratch))
        if code != 0:
            port.ending = code


# Receiving


@inlined
def _receive(joint, now):
    """Waits for positions, and puts the next one of each port into its decoder."""
    is_open = False  # a descriptor brings news; what is in memory is there or does not come
    for p in range(np.uint64(joint.count)):
        port = joint.ports[p]
        joint.polled[p] = -1
        if not _loop_at(port.loop).control.go:
            port.heard_ns = now
        if _is_awaited(port):
            _hold_next(joint, port, now)  # bytes that came behind the answer to ARM
        if _is_awaited(port):
            joint.polled[p] = inbox_at(_loop_at(port.loop).inbox).transport.descriptor
            is_open = is_open or joint.polled[p] >= 0
    timeout = _time_to_wait(joint, now)
    if timeout > 0 and is_open:
        wait_for_any(joint.polled, joint.count, timeout, joint.scratch)
    elif timeout > 0 and not joint.begun:
        sleep_until(now + timeout, joint.scratch)
    for p in range(np.uint64(joint.count)):
        port = joint.ports[p]
        if not _is_awaited(port) or (timeout > 0 and is_open and not has_news(joint.polled[p])):
            continue
        inbox = inbox_at(_loop_at(port.loop).inbox)
        if inbox.start < inbox.stop:  # its device was armed a moment ago: what came behind the answer is the first
            continue
        inbox.start = inbox.stop = at = next_place(inbox.last)
        code = receive(inbox.transport, inbox.bytes, at, AT_ONCE, 0)
        if code < 0:
            port.ending = code
            continue
        inbox.stop = inbox.last.at = at + code
        _hold_next(joint, port, now_ns(joint.scratch))


@inlined
def _is_awaited(port):
    """Returns whether the loop waits for the next position of a port."""
    return port.ending == RUNNING and port.held == 0 and _loop_at(port.loop).control.go != 0


@inlined
def _time_to_wait(joint, now):
    """Returns for how long the loop may wait, ns: not at all if it can go on, and never too long to see a stop."""
    ready, waiting, until = 0, 0, now + SLICE_NS
    for p in range(np.uint64(joint.count)):
        port = joint.ports[p]
        if port.ending != RUNNING:
            continue
        ready, waiting = ready + port.held, waiting + 1 - port.held
        silent = port.heard_ns + _loop_at(port.loop).control.silence_ns
        until = min(until, silent, port.release_by_ns if port.releases else silent)
    if not joint.begun:
        return min(until - now, _GO_CHECK_NS)
    if joint.clock == HOST_CLOCK:
        return joint.due_ns - now if waiting > 0 else 0
    if waiting == 0 or (joint.clock == DEVICE_CLOCK and ready > 0):
        return 0
    return until - now


_GO_CHECK_NS = 50_000  # until all devices are armed


@helper
def _hold_next(joint, port, now):
    """Puts the next position among a port's bytes, which arrived at `now`, into its decoder, and goes on with the clock
    to it."""
    loop = _loop_at(port.loop)
    inbox = inbox_at(loop.inbox)
    while inbox.start < inbox.stop and port.held == 0 and port.ending == RUNNING:
        inbox.start, found = next_frame(inbox.decoder, inbox.bytes, inbox.start, inbox.stop)
        if not found:
            continue
        decoder = inbox.decoder
        gap = 1 if loop.state.ticks == 0 else (decoder.number - loop.state.sample) & _MODULUS_MASK
        if decoder.type not in (schema.POSITION, schema.POSITION_HELD) or not 0 < gap < schema.SAMPLE_MODULUS // 2:
            _take(port, loop, now)
            continue
        port.held, port.gap, port.arrived_ns, port.heard_ns = 1, gap, now, now
        if not joint.begun:
            _begin_at(port, loop, decoder)
        elif joint.clock == HOST_CLOCK:
            port.clock.time_ns = np.float64(joint.tick_ns)
            publish_hands(port, loop, decoder)
        else:
            advance_clock(port.clock, now, gap)


@helper
def _take(port, loop, now):
    """Lets an exchange take the frame in a port's decoder."""
    code = take_frame(loop, inbox_at(loop.inbox).decoder, now)
    if code < TIMED_OUT:
        port.ending = code


# The first positions


@inlined
def _begin_at(port, loop, decoder):
    """Takes the first position of a device as the place where its points are."""
    for c in range(np.uint64(loop.io.channels)):
        if loop.io.origin_at_arming[c]:
            loop.io.origin_counts[c] = decoder.counts[c]
    publish_hands(port, loop, decoder)
    port.greeted = 1


@inlined
def _greet(joint, now):
    """Answers devices that pace with zero force. Returns 1 once the first positions of all are known."""
    known = 1
    for p in range(np.uint64(joint.count)):
        port = joint.ports[p]
        known = known if port.greeted else 0
        if port.held and joint.clock == DEVICE_CLOCK:
            loop = _loop_at(port.loop)
            port.held, port.sends, loop.state.sample = 0, _FORCE, inbox_at(loop.inbox).decoder.number
    if known:
        joint.begun_ns = joint.tick_ns = now
        joint.due_ns = now + _loop_at(joint.ports[0].loop).control.period_ns
        for p in range(np.uint64(joint.count)):
            clock = joint.ports[p].clock
            if joint.clock == HOST_CLOCK:
                clock.time_ns = np.float64(now)
            elif joint.ports[p].held:
                advance_clock(clock, now, 1)
    return known


# Exchanges


@inlined
def _exchange_earliest(joint):
    """Answers the position that was sampled first. In virtual time all ports have one before the loop goes on."""
    first, all_held = np.int64(-1), True
    for p in range(np.uint64(joint.count)):
        port = joint.ports[p]
        if port.ending == RUNNING and port.held == 0:
            all_held = False
        elif port.ending == RUNNING and (first < 0 or port.clock.time_ns < joint.ports[first].clock.time_ns):
            first = np.int64(p)
    if first < 0 or not (all_held or joint.clock == DEVICE_CLOCK):
        return
    port = joint.ports[first]
    now = np.int64(port.clock.time_ns)
    if joint.clock == MEMORY_CLOCK:
        now = _sleep_to_sample(joint, port)
    _move(joint, port, port.arrived_ns if joint.clock == DEVICE_CLOCK else now)
    publish_hands(port, _loop_at(port.loop), inbox_at(_loop_at(port.loop).inbox).decoder)
    publish_masses(port, _loop_at(port.loop))
    _hold_next(joint, port, port.arrived_ns)
    if port.held == 0 and port.ending == RUNNING:
        port.sends = _FORCE


@inlined
def _move(joint, port, now):
    """Lets the scene of a port move to its position."""
    loop = _loop_at(port.loop)
    locate_points(joint.ports, port, loop.io)
    port.held = 0
    _take(port, loop, now)


@inlined
def _sleep_to_sample(joint, port):
    """Sleeps until a mock in memory samples, and counts how late that is. Returns the time."""
    loop = _loop_at(port.loop)
    due = joint.begun_ns + np.int64(port.clock.time_ns)
    now = sleep_to(due, now_ns(joint.scratch), loop.control, joint.scratch)
    note(loop.histograms.lateness, now - due)
    _, missed = next_point(due, now, loop.control.period_ns)
    loop.state.deadline_misses += missed
    joint.begun_ns += (now - due) * missed  # no burst: the grid begins anew
    return now


@inlined
def _exchange_on_grid(joint, now):
    """Answers all positions of a tick of the host's together: when they are there, or the next tick is due. Then it is
    time to send the forces, which request the next positions."""
    waiting = 0
    for p in range(np.uint64(joint.count)):
        waiting += joint.ports[p].ending == RUNNING and joint.ports[p].held == 0
    is_due = now >= joint.due_ns
    if waiting > 0 and not is_due:
        return
    for p in range(np.uint64(joint.count)):
        port = joint.ports[p]
        while port.ending == RUNNING and port.held:  # after a request that was repeated, there may be two
            _move(joint, port, port.arrived_ns)
            publish_masses(port, _loop_at(port.loop))
            _hold_next(joint, port, port.arrived_ns)
    if not is_due:
        now = sleep_to(joint.due_ns, now, _loop_at(joint.ports[0].loop).control, joint.scratch)
    joint.tick_ns = now
    period = _loop_at(joint.ports[0].loop).control.period_ns
    for p in range(np.uint64(joint.count)):
        port = joint.ports[p]
        if port.ending == RUNNING:
            loop = _loop_at(port.loop)
            note(loop.histograms.lateness, now - joint.due_ns)
            _, missed = next_point(joint.due_ns, now, period)
            loop.state.deadline_misses += missed
            port.sends = _FORCE
    joint.due_ns, _ = next_point(joint.due_ns, now, period)
