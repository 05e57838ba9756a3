"""The mock's memory: records of its firmware, converters and bodies, and the functions that it calls by address."""

from __future__ import annotations

import numpy as np
from numba import types

from firmware_protocol import schema
from firmware_protocol.decoder import DECODER
from firmware_protocol.frames import FRAMING
from hapsim.compiling.native import array_at, function_at, record_at
from hapsim.device.mock.motion import BODY, COUPLING
from hapsim.device.mock.sampler import CONVERTER, MOST_AGES
from hapsim.device.mock.transmission import DRIVE
from hapsim.scene.mock_limits import MOST_CHANGES

OUTBOX_BYTES = 81920
INPUT_BYTES = 4096  # at most for one `take_bytes`: the answers fit the outbox
LONGEST_DELAY = 1000  # samples
MOST_LATE = schema.MAX_TIME_TO_LIVE_SAMPLES  # samples: no later force ever acts
MOST_GRIPS = 1000
LONGEST_ANSWER = schema.frame_bytes(schema.MAX_CHANNELS, to_device=False, parts=schema.PART_BITS)

BOARD = np.dtype(
    [
        ("state", np.int64),  # IDLE, ARMED, LATCHED
        ("fault", np.int64),
        ("pacing", np.int64),
        ("parts", np.int64),  # of schema.PARTS, which it sends with the positions
        ("watchdog", np.int64),  # samples
        ("n", np.int64),  # the current sample
        ("answered", np.int64),  # the sample that the newest accepted force answers
        ("expires", np.int64),  # the last sample in which that force may act
        ("accepted", np.int64),  # the sample in which the last force was accepted
        ("accepted_ns", np.int64),
        ("sampled_ns", np.int64),
        ("outputs", np.int64),  # the output word of the newest accepted force
        ("lives", np.float64),  # s of the current sample for which a force may act, paced by the host
        ("out", np.int64),  # bytes in the outbox
        ("scale_out_of_range", np.int64),
    ]
)

CALLED = np.dtype(
    [
        ("take_bytes", np.uint64),  # the events
        ("take_sample", np.uint64),  # or `move_hand` before it
        ("check_watchdog", np.uint64),
        ("take_force", np.uint64),  # for a received force: `act_on_force`, or `take_late_force` before it
        ("act_on_force", np.uint64),
        ("read", np.uint64),  # the codec
        ("put_frame", np.uint64),
        ("advance", np.uint64),  # of the bodies through a sample: each by `move`, `advance_coupled`, `advance_driven`
        ("move", np.uint64),  # of motion.py
        ("begin_following", np.uint64),  # of line_follower.py or servo.py, where the mock follows lines or commands
        ("take_followed", np.uint64),
        ("advance_following", np.uint64),  # in place of `advance`
        ("move_servo", np.uint64),  # of motion.py
    ],
    align=True,
)
"""Addresses of functions that the mock calls."""

_EACH = (schema.MAX_CHANNELS,)
_WORDS = (schema.MAX_WORDS,)
FORCE_UNDER_WAY = np.dtype([("number", np.int64), ("argument", np.int64), ("counts", np.int64, _WORDS)], align=True)
CHANCE = np.dtype([("share", np.float64), ("seed", np.uint64), ("state", np.uint64)], align=True)
GRIP = np.dtype([("sample", np.int64), ("mass", np.float64)], align=True)
FLIP = np.dtype([("sample", np.int64), ("inputs", np.int64)], align=True)
FORMATS = np.dtype([("setup", FRAMING), ("armed", FRAMING, (schema.PART_BITS + 1,))], align=True)
"""`armed`: by the parts that are on the wire."""

MOST_STEPS = 1000  # local periods in a sample, in the board's delay, and in its window
KEPT_REPORTS = 32  # samples
LINE = np.dtype(
    [(name, np.int64) for name in ("force", "stiffness", "damping", "low", "high", "position")],  # counts
    align=True,
)
FOLLOWER = np.dtype(
    [
        ("steps", np.int64),  # local periods in a sample; 0: the mock follows no lines
        ("delay", np.int64),  # local periods from a measurement until its force acts
        ("window", np.int64),  # local periods, of the velocity
        ("late", np.int64),  # local periods from a position until the line that answers it is used
        ("limit", np.int64, _EACH),  # counts
        ("shifts", np.int64, (schema.MAX_CHANNELS, 2)),  # of stiffness and damping
        ("largest", np.int64, (schema.MAX_CHANNELS, 2)),  # counts
        ("lines", LINE, (LONGEST_DELAY + MOST_AGES, schema.MAX_CHANNELS)),  # a ring of samples, as `commands`
        ("reports", np.int64, (KEPT_REPORTS, schema.MAX_CHANNELS)),  # counts, a ring of samples
        ("past", np.int64, (MOST_STEPS, schema.MAX_CHANNELS)),  # positions, counts, a ring of local periods
        ("under_way", np.int64, (MOST_STEPS + 1, schema.MAX_CHANNELS)),  # forces, counts, a ring of local periods
    ],
    align=True,
)
"""Board of a mock that follows lines."""

FORCE_SENSOR = np.dtype(
    [
        ("quantum", np.float64),  # N per count
        ("range", np.float64),  # N
        ("offset", np.float64),  # N
        ("drift", np.float64),  # N per sample
        ("noise", np.float64),  # N rms
        ("fault", np.int64),  # code of servo.FAULTS, which begins
        ("fault_sample", np.int64),  # in this sample
        ("counts", np.int64),  # shown last
        ("position", np.float64),  # m, of the hand at the last sample
        ("before", np.float64),  # and at the one before
        ("seed", np.uint64),
        ("state", np.uint64),
    ],
    align=True,
)
"""Sensor of the force between hand and handle."""

MOCK = np.dtype(
    [
        ("board", BOARD),
        ("channels", np.int64),
        ("bodies", BODY, _EACH),
        ("initial", BODY, _EACH),
        ("coupling", COUPLING),  # of bodies whose mass is a matrix
        ("drives", DRIVE, _EACH),  # of bodies that `advance_driven` moves
        ("converters", CONVERTER, _EACH),
        ("depth", np.int64),  # rows of commands in use
        ("commands", np.float64, (LONGEST_DELAY + MOST_AGES, schema.MAX_CHANNELS)),  # N, a ring of samples
        ("follower", FOLLOWER),
        ("servos", BODY, _EACH),  # of servo.py: commands move these, which carry the bodies; mass 0: no servo
        ("force_sensors", FORCE_SENSOR, _EACH),
        ("longest_way", np.float64, _EACH),  # m, from one command to the next
        ("braking_way", np.float64, _EACH),  # m, by which that shrinks in a sample of braking
        ("late_share", np.float64),  # of a sample, by which commands are later than by whole ones
        ("offered", np.int64),  # bits of ARM: the parts that it can send or take
        ("force_scale", np.float64, _EACH),
        ("force_limit", np.float64, _EACH),
        ("counts", np.int64, (schema.MAX_WORDS,)),  # of the next frame: all positions, then the parts
        ("registers", np.int64, (schema.REGISTERS,)),
        ("host_formats", FORMATS),  # of the host's frames
        ("mock_formats", FORMATS),  # of the mock's frames
        ("decoder", DECODER),
        ("outbox", np.uint8, (OUTBOX_BYTES,)),
        ("late_samples", np.int64),  # that a force spends on the wire in virtual time
        ("under_way", FORCE_UNDER_WAY, (MOST_LATE + 1,)),  # by the sample in which it was sent
        ("chance", CHANCE),  # the share of forces that never arrive; seed and state of the generator
        ("grips", GRIP, (MOST_GRIPS + 1,)),  # mass of the bodies (kg) from a sample on; the last never comes
        ("gripped", np.int64),  # count of past grips
        ("inputs", np.int64),  # the digital input word now: what the next position brings,
        ("switched", np.int64),  # but for these bits, which another thread turned over
        ("first_inputs", np.int64),  # at arming
        ("flips", FLIP, (MOST_CHANGES + 1,)),  # inputs that change at a sample, in order; the last never comes
        ("flipped", np.int64),  # count of past flips
        ("outputs", np.int64),  # the digital output word that acts; 0 unless armed
        ("byte_ns", np.float64),  # of a byte on the wire, in real time
        ("turnaround_ns", np.float64),  # before the first byte of an answer
        ("hand", np.uint64),  # address of a LIVE_HAND; 0: the hand has not changed yet
        ("recorded", np.uint64),  # address of a RECORDED, whose positions are sent in place of its own; 0: none
        ("address", np.uint64),  # of this record
        ("called", CALLED),
    ],
    align=True,
)
"""The mock: its bodies (one per channel), converters, history of commands, registers and bytes."""

mock_at, framing_at, bytes_at = record_at(MOCK), record_at(FRAMING), array_at(np.uint8)

call_take_bytes = function_at(types.void(types.uint64, types.uint64, types.int64, types.int64))
call_event = function_at(types.void(types.uint64, types.int64))
"""Calls an event from compiled code, with the mock's address and the time in ns."""

call_for_all = function_at(types.void(types.uint64))
call_take = function_at(types.int64(types.uint64))
call_advance = function_at(types.void(types.uint64, types.float64, types.float64))
call_read = function_at(types.int64(types.uint64, types.uint64, types.int64, types.int64))
call_put_frame = function_at(types.void(types.uint64, types.uint64, types.int64, types.int64))
