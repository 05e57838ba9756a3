"""A device written once more from PROTOCOL.md, in plain Python. What it does wrong is said in its options:
{"faults": ["inverted_sign"], ...}. It shares nothing with hapsim, and imports nothing but the standard library."""

from __future__ import annotations

import math
import struct
from itertools import pairwise

SCHEMA = 0x314A417F
MARK, ACCELERATION_MARK, LINE_MARK, WORDS_MARK = 0x56454C01, 0x41434302, 0x4C494E03, 0x5349470E
HAND_FORCE_MARK, COMMAND_MARK = 0x46524304, 0x434D4405
IDLE, ARMED, LATCHED = range(3)
DESCRIBE, ARM, FORCE, DISARM = 1, 2, 3, 4
DESCRIPTION, POSITION, HELD, STATUS = 9, 10, 11, 12


def table_of(polynomial):
    table = []
    for value in range(256):
        for _ in range(8):
            value = value >> 1 ^ (polynomial if value & 1 else 0)  # noqa: PLW2901
        table.append(value)
    return table


CRC16, CRC32C = table_of(0xA6BC), table_of(0x82F63B78)


class Format:
    def __init__(self, channels, parts=0, seed=None):
        self.channels = channels
        self.host_words = channels * (1 + (parts & 0xE0).bit_count()) + bool(parts & 0x10)
        self.device_words = channels * ((3 if parts & 4 else 1) + bool(parts & 8)) + bool(parts & 0x10)
        self.long = max(self.host_words, self.device_words) > 3
        word = SCHEMA ^ (MARK if parts & 0x80 else 0) ^ (ACCELERATION_MARK if parts & 0x20 else 0)
        word ^= (LINE_MARK if parts & 4 else 0) ^ (WORDS_MARK if parts & 0x10 else 0)
        word ^= (HAND_FORCE_MARK if parts & 0x40 else 0) ^ (COMMAND_MARK if parts & 8 else 0)
        self.seed = seed if seed is not None else word if self.long else (word ^ word >> 16) & 0xFFFF

    def check(self, encoded):
        table, crc = (CRC32C if self.long else CRC16), self.seed
        for byte in encoded:
            crc = crc >> 8 ^ table[(crc ^ byte) & 0xFF]
        crc ^= 0xFFFFFFFF if self.long else 0xFFFF
        return bytes(0x80 | crc >> 7 * i & 0x7F for i in range(5 if self.long else 3))

    def to_host(self, kind, number, words):
        body = struct.pack(">H", kind << 12 | number & 4095)
        body += struct.pack(f"<{self.host_words}i", *([*words, *[0] * 48][: self.host_words]))
        encoded = bytearray(b"\0" + body)
        zeros = [0] + [i + 1 for i, byte in enumerate(body) if byte == 0] + [len(body) + 1]
        for here, there in pairwise(zeros):
            encoded[here] = there - here
        return bytes(encoded) + self.check(encoded) + b"\0"

    def from_host(self, candidate):
        """(type, number, argument, words), or the name of what is wrong."""
        count = 1 + 3 + 4 * self.device_words
        encoded = candidate[:count]
        if self.check(encoded) != candidate[count:]:
            return "crc"
        body, at = bytearray(encoded), 0
        while at < count:
            step, body[at] = body[at], 0
            if step == 0:
                return "form"
            at += step
        kind, number = body[1] >> 4, (body[1] & 15) << 8 | body[2]
        if at != count or not DESCRIBE <= kind <= DISARM:
            return "form"
        return kind, number, body[3], struct.unpack_from(f"<{self.device_words}i", body, 4)

    @property
    def length(self):
        return 1 + 3 + 4 * self.device_words + (5 if self.long else 3)


SETUP = Format(1, seed=0x4853)


class Mass:
    """A mass with viscous friction, moved exactly under a force that is held. `hand`: a constant pull, N."""

    def __init__(self, mass=0.2, friction=1.0, x=0.0, v=0.0, hand=0.0):
        self.mass, self.friction, self.x, self.v, self.hand = mass, friction, x, v, hand

    def move(self, force, seconds):
        rate, rest = self.friction / self.mass, (force + self.hand) / self.friction
        gone = -math.expm1(-rate * seconds)
        self.x += rest * seconds + (self.v - rest) * gone / rate
        self.v += (rest - self.v) * gone


class Device:
    """`put(data)` hands bytes to the transmitter, which tells for how many it had room; `now()`: a clock, s."""

    def __init__(self, put, now, options):
        self.put_out_bytes, self.now, self.options = put, now, options
        self.faults = set(options.get("faults", ()))
        self.channels = options.get("channels", 1)
        self.rate = options.get("rate", 500.0)
        self.pacings = options.get("pacings", 3)
        self.max_watchdog = options.get("max_watchdog", 2047)
        self.senses, self.accelerates = options.get("senses", True), options.get("accelerates", False)
        self.acceleration = 1e-4 * options.get("acceleration_off_by", 1.0)
        self.scale, self.force_scale, self.limit = options.get("scale", 1e-8), 1e-7, options.get("limit", 10.0)
        self.bodies = [Mass() for _ in range(self.channels)]
        self.turned = options.get("turned", 0.0)  # degrees from the first two motors to their encoders
        self.dies_at = options.get("dies_at", math.inf)  # the sample from which on the encoders stand still,
        self.stuck_at = options.get("stuck_at", math.inf)  # and the sensors of acceleration
        self.answers_after = options.get("answers_after", 0.0)  # s, where the host paces
        self.kept, self.kept_acceleration, self.answer_at = [], [], None
        self.wire, self.rest, self.unsent, self.waiting, self.torn = SETUP, b"", b"", b"", False
        self.state, self.fault, self.pacing, self.watchdog = IDLE, 0, 0, 0
        self.n = self.answered = self.latest_force = self.expires = 0
        self.counters = dict.fromkeys(("accepted", "rejected", "held", "expired", "limited"), 0)
        self.output = self.command = self.previous = [0.0] * self.channels
        self.moved_at = self.due = now()
        self.force_at, self.life = 0.0, math.inf
        self.farthest, self.fastest = 0.0, 0.0  # m, m/s
        self.largest = 0.0  # N, of what was asked for
        self.kept_reports = options.get("kept_reports", 32)
        self.steps = options.get("steps", 0)  # local periods in a sample, where it follows lines
        self.words = options.get(
            "words"
        )  # the number of outputs that are wired to inputs; None: a firmware without them
        self.outputs = self.set_outputs = 0
        self.servo = options.get("servo")  # its speed limit, m/s, and braking, m/s²
        self.wanted, self.reference, self.speed = [], [], []  # m, m, m per sample
        self.reported, self.past, self.line, self.coming, self.next = [], [], None, None, None
        self.own = self.registers()

    # What it says of itself.

    def registers(self):
        own = {0: 1, 1: SCHEMA, 2: self.channels, 3: self.pacings, 6: self.max_watchdog}
        self.put(own, 4, self.rate)
        name = self.options.get("name", "probed").encode("latin-1").ljust(16, b"\0")
        own.update(zip(range(16, 20), struct.unpack("<4I", name), strict=True))
        for c in range(self.channels):
            velocity = self.scale * 100 if self.senses else 0.0
            for i, value in enumerate((self.scale, self.force_scale, self.limit, velocity)):
                self.put(own, 32 + 8 * c + 2 * i, value)
        if self.accelerates:
            own[15] = 1
            for c in range(self.channels):
                self.put(own, 160 + 16 * c, 1e-4)
        if self.words is not None:
            own[15] = 4 | own.get(15, 0)
        if self.servo:
            own[15] = 18 | own.get(15, 0)
            for c in range(self.channels):
                for i, value in enumerate((1e-4, 50.0, *self.servo, 0.0, 1.0)):
                    self.put(own, 164 + 16 * c + 2 * i, value)
        if self.steps:
            own |= {15: 8 | own.get(15, 0), 20: self.steps, 21: 1, 22: self.steps, 23: self.kept_reports}
            own |= {163 + 16 * c: 32767 << 16 | 65535 for c in range(self.channels)}  # no shifts
        own.update({int(number): value for number, value in self.options.get("registers", {}).items()})
        return own

    def put(self, own, at, value):
        own[at], own[at + 1] = struct.unpack("<II", struct.pack("<d", value))

    def register(self, number):
        counters = dict(enumerate(self.counters.values(), 8))
        value = self.own.get(number, counters.get(number, self.fault if number == 7 else 0))
        return value - (1 << 32) if value >= 1 << 31 else value

    # Bytes.

    def write(self, frame):
        """Never waits; what found room in part goes first."""
        if "waits_for_room" in self.faults:
            self.unsent += frame
            self.flush()
            return
        self.flush()
        self.torn = self.torn or bool(self.unsent)
        if not self.unsent:
            frame = frame[5 if self.torn and "tears_frames" in self.faults else 0 :]
            self.torn = False
            self.unsent = frame[self.put_out_bytes(frame) :]

    def flush(self):
        """Sends as many bytes as there is room for. Returns whether none are left."""
        if self.unsent:
            self.unsent = self.unsent[self.put_out_bytes(self.unsent) :]
        return not self.unsent

    def waits(self):
        """Returns whether everything waits for room to send; an interrupt in that time is lost."""
        if "waits_for_room" in self.faults and not self.flush():
            self.due = self.now() + self.period
            return True
        return False

    def take(self, data):
        self.waiting += data
        if self.waits():
            return
        data, self.waiting = self.waiting, b""
        pieces = (self.rest + data).split(b"\0")
        self.rest = pieces.pop()[-1000:]
        for piece in pieces:
            if not piece:
                continue
            if len(piece) < self.wire.length:
                self.counters["rejected"] += 1
                continue
            frame = self.wire.from_host(piece[-self.wire.length :])
            if "short_words" in self.faults and not isinstance(frame, str) and self.wire.device_words > self.channels:
                frame = "form" if frame[3][-1] >> 16 else frame
            if frame == "crc" and "answers_damaged" in self.faults:
                sound = piece[: -(5 if self.wire.long else 3)][-self.wire.length :]
                frame = self.wire.from_host(sound + self.wire.check(sound))
            if isinstance(frame, str):
                self.counters["rejected"] += 1
            else:
                self.act(*frame)

    def act(self, kind, number, argument, words):
        if kind == DISARM:
            self.stop(IDLE)
            self.status()
        elif self.state == ARMED:
            if kind == FORCE:
                self.take_force(number, argument, words)
        elif kind == ARM:
            self.arm(number, argument, words[0] & 0xFFFFFFFF)
        elif kind == DESCRIBE:
            self.write(self.wire.to_host(DESCRIPTION, number, [self.register(number)]))

    # Samples.

    def status(self):
        self.write(self.wire.to_host(STATUS, self.n, [self.state | self.fault << 8]))

    def refusal(self, watchdog, pacing, parts, word):
        if word != SCHEMA and "any_schema" not in self.faults:
            return 3
        if pacing > 2 or not self.pacings >> pacing & 1:
            return 4
        if pacing == 1 and parts & 12:
            return 4
        lacks = parts & 4 and not self.steps
        if (parts & 0x80 and not self.senses) or (parts & 0x20 and not self.accelerates) or lacks:
            return 7
        return 0 if 1 <= watchdog <= self.max_watchdog else 5

    def arm(self, watchdog, argument, word):
        known = (0xA4 if self.words is None else 0xB4) | (0x48 if self.servo else 0)
        parts, pacing = argument & known, argument & ~known
        self.n, self.fault = 0, self.refusal(watchdog, pacing, parts, word)
        if self.fault:
            return self.status()
        self.state, self.pacing, self.watchdog, self.parts = ARMED, pacing, watchdog, parts
        if "bodies" in self.options:  # a hand holds them until then
            self.bodies, self.moved_at = [Mass(**one) for one in self.options["bodies"]], self.now()
        self.answered = self.latest_force = self.expires = -1
        if "keeps_counters" not in self.faults:
            self.counters = dict.fromkeys(self.counters, 0)
        self.status()
        self.wire = Format(self.channels, parts)
        self.force_at, self.life = self.now(), math.inf
        self.due = self.now() + self.period
        self.line = self.coming = self.next = None
        self.reference, self.speed = [body.x for body in self.bodies], [0.0] * self.channels
        self.send_position(POSITION)
        self.past = [self.reported[-1]] * self.steps
        return None

    @property
    def period(self):
        slower = 4.0 if "slows_down" in self.faults and self.n > 150 else 1.0
        return slower / self.rate / (1.02 if "fast" in self.faults else 1.0)

    def take_force(self, number, time_to_live, words):
        age = (self.n - number) & 4095
        forgotten = self.parts & 4 and age >= self.kept_reports and "never_forgets" not in self.faults
        if forgotten or (age > time_to_live and "never_expires" not in self.faults):
            self.counters["expired"] += 1
            return
        if self.parts & 4:
            line = self.line_of(age, words)
            if line is None:
                return
            self.coming = line
        self.counters["accepted"] += 1
        self.command = []
        if self.parts & 0x10:
            self.set_outputs = words[-1]
        self.wanted = (
            [count * self.scale for count in words[self.channels : 2 * self.channels]] if self.parts & 8 else []
        )
        for count in [] if self.parts & 12 else words[: self.channels]:
            force = count * self.force_scale
            self.largest = max(self.largest, abs(force))
            if abs(force) > self.limit and "never_cuts" not in self.faults:
                self.counters["limited"] += 1
                force = math.copysign(self.limit, force)
            self.command.append(force)
        self.answered, self.latest_force = self.n - age, self.n
        self.expires = self.answered + time_to_live
        self.force_at, self.life = self.now(), (time_to_live + 1) / self.rate
        if "on_arrival" in self.faults:
            self.put_out(self.command)
        if self.pacing != 0 and self.answers_after:
            self.answer_at = self.answer_at or self.now() + self.answers_after
        elif self.pacing != 0:
            self.tick(self.now())

    # Position commands: section 6.2.

    def serve(self):
        """At a tick: the bodies arrive where they were commanded to, and the next commands act."""
        for c, body in enumerate(self.bodies):
            body.x, body.v = self.reference[c], 0.0
            if self.latest_force == self.n:
                most = self.servo[0] / self.rate + self.scale
                far = self.wanted[c] - self.reference[c]
                self.counters["limited"] += abs(far) > most
                self.speed[c] = max(-most, min(far, most))
            elif self.n > self.expires and "never_brakes" not in self.faults:
                less = self.servo[1] / self.rate**2 / (3.0 if "brakes_softly" in self.faults else 1.0)
                self.speed[c] = math.copysign(max(abs(self.speed[c]) - less, 0.0), self.speed[c])
            self.reference[c] += self.speed[c]
        self.moved_at = self.now()

    # Lines: section 6.1.

    def line_of(self, age, words):
        """The line of a FORCE, for each channel (F, k, b, low, high, x_n); None where a low is above its high."""
        lines = []
        for c in range(self.channels):
            first, second = words[self.channels + 2 * c : self.channels + 2 * c + 2]
            low, high = second >> 16, (second & 0xFFFF ^ 0x8000) - 0x8000
            if low > high and "any_bounds" not in self.faults:
                self.counters["rejected"] += 1
                return None
            unit = 1.0 if "no_bounds" not in self.faults else 1e9
            bounds = (
                low / 32767 * self.limit / self.force_scale * unit,
                high / 32767 * self.limit / self.force_scale * unit,
            )
            x = self.reported[-1 if "newest_position" in self.faults else -1 - min(age, len(self.reported) - 1)][c]
            lines.append([words[c], first >> 16, first & 0xFFFF, *bounds, x])
        return lines

    def follow(self, seconds):
        """Moves through the local periods of a sample. `seconds`: its duration."""
        for _ in range(self.steps):
            self.output = [force * self.force_scale for force in self.next or [0.0] * self.channels]
            x = [round(body.x / self.scale) for body in self.bodies]
            places = zip(self.line or [], x, self.past[0], strict=False)
            self.next = [self.force_along(*one) for one in places]
            self.past = [*self.past[1:], x]
            for body, force in zip(self.bodies, self.output, strict=True):
                body.move(-force if "inverted_sign" in self.faults else force, seconds / self.steps)

    def force_along(self, line, x, before):
        force, k, b, low, high, kept = line
        if "newest_position" in self.faults:
            kept = self.reported[-1][0]
        u = force - (k * (x - kept) >> (1 if "wrong_shift" in self.faults else 0))
        if not low < u < high:
            return max(low, min(u, high))
        return max(low, min(u - b * (x - before) * (4 if "short_window" in self.faults else 1), high))

    def next_line(self):
        """At a tick: the line of the sample that ended."""
        if self.latest_force == self.n:
            self.line = self.coming
        elif self.n > self.expires:
            self.line = None
        elif self.line and "keeps_pushing" not in self.faults:
            self.line = [[force, max(k, 0), *rest] for force, k, *rest in self.line]

    def put_out(self, forces):
        """Puts out forces, after moving the bodies up to now."""
        self.move(self.now())
        self.output = list(forces)

    def move(self, now):
        """At most for a sample, however much later this process came to it."""
        seconds = now - self.moved_at
        if self.pacing == 0 and self.state == ARMED:
            seconds = min(seconds, max(self.due - self.moved_at, 0.0))
        made = self.output
        if motors := self.options.get("motors"):  # rows: what each body gets of the forces
            made = [sum(share * force for share, force in zip(row, self.output, strict=True)) for row in motors]
        for body, force in zip(self.bodies, made, strict=True):
            body.move(-force if "inverted_sign" in self.faults else force, max(seconds, 0.0))
        self.moved_at = (
            max(now, self.moved_at) if self.pacing or self.state != ARMED else self.moved_at + max(seconds, 0.0)
        )

    def tick(self, now):
        fresh = self.latest_force == self.n and self.answered == self.n
        self.counters["held"] += not fresh
        if self.latest_force != self.n and self.n > self.expires and "never_ends" not in self.faults:
            self.command = [0.0] * self.channels
        if self.parts & 4:
            self.follow(max(now - self.moved_at, 0.0))
            self.moved_at = now
            self.next_line()
        elif self.parts & 8:
            self.serve()
        else:
            self.move(now)
            self.previous, self.output = self.output, list(self.command)
        if "late_outputs" not in self.faults:
            self.outputs = self.set_outputs
        self.n += 2 if "skips" in self.faults and self.n % 50 == 49 else 1
        self.send_position(POSITION if fresh or "always_fresh" in self.faults else HELD)

    def send_position(self, kind):
        scale = self.scale * (0.5 if "wrong_scale" in self.faults else 1.0)
        places = [body.x for body in self.bodies]
        if self.turned:
            c, s = math.cos(math.radians(self.turned)), math.sin(math.radians(self.turned))
            places[:2] = c * places[0] - s * places[1], s * places[0] + c * places[1]
        counts = [round(place / scale) for place in places]
        if self.n >= self.dies_at:
            counts = self.kept
        self.kept = list(counts)
        self.farthest = max(self.farthest, math.hypot(*(body.x for body in self.bodies)))
        self.fastest = max(self.fastest, math.hypot(*(body.v for body in self.bodies)))
        if "frozen" in self.faults:
            counts = [0] * self.channels
        if "swapped" in self.faults:
            counts[:2] = counts[1::-1]
        self.reported = [*self.reported[-40:], list(counts)]
        if self.parts & 0x80:
            counts += [round(body.v / (self.scale * 100)) for body in self.bodies]
        if self.parts & 0x20:
            late = self.previous if "late_acceleration" in self.faults else self.output
            sign = -1 if "inverted_sign" in self.faults else 1
            pulls = [sign * force - body.friction * body.v for body, force in zip(self.bodies, late, strict=True)]
            if self.n < self.stuck_at:
                pulls = zip(pulls, self.bodies, strict=True)
                self.kept_acceleration = [round(pull / body.mass / self.acceleration) for pull, body in pulls]
            counts += self.kept_acceleration or [0] * self.channels
        if self.parts & 0x40:
            counts += [0] * self.channels
        if self.parts & 0x10:
            low = (
                self.outputs & (1 << self.words) - 1
            )  # its inputs: these, and bit 31, which is never the same for long
            word = low | (self.n >> 2 & 1) << 31
            counts.append(word - (word >> 31 << 32))
            self.outputs = self.set_outputs
        self.write(self.wire.to_host(kind, self.n, counts))

    def stop(self, state):
        self.move(self.now())
        self.outputs = self.set_outputs = 0
        self.state, self.command, self.output = state, [0.0] * self.channels, [0.0] * self.channels
        if state == IDLE:
            self.wire, self.rest = SETUP, b""

    def look(self):
        """Handles the events of the device's own clock."""
        if self.waits():
            return
        now = self.now()
        if self.state == ARMED and self.pacing == 0:
            while now >= self.due and self.state == ARMED:
                self.tick(self.due)
                self.due += self.period
                if self.waits():
                    return
                self.latch_where(self.n - self.latest_force > self.watchdog)
        elif self.state == ARMED and self.answer_at is not None:
            if now >= self.answer_at:
                self.answer_at = None
                self.tick(now)
        elif self.state == ARMED:
            quiet = now - self.force_at
            if quiet > self.life and "never_ends" not in self.faults:
                self.put_out([0.0] * self.channels)
                self.life = math.inf
            self.latch_where(quiet * self.rate > self.watchdog)
        elif "chatters" in self.faults:
            self.write(b"hello\r\n")

    def latch_where(self, silent):
        if silent and "no_watchdog" not in self.faults:
            self.stop(LATCHED)
            self.fault = 1
            if "latches_in_setup" in self.faults:
                self.wire = SETUP
            self.status()
            self.wire, self.rest = SETUP, b""

    def wait(self):
        """s until the clock brings something, at most 2 ms."""
        ticking = self.state == ARMED and self.pacing == 0
        return min(max(self.due - self.now(), 0.0), 0.002) if ticking else 0.002
