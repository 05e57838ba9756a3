/* SPDX-License-Identifier: MIT */
#include "hapsim_board.h"
#ifndef HAPSIM_BOARD_DIGITAL_WORD
#define HAPSIM_BOARD_DIGITAL_WORD 0 /* 1: the board has inputs and outputs */
#endif
#ifdef HAPSIM_BOARD_STEPS
#define HAPSIM_HOST_WORDS (3 * HAPSIM_BOARD_CHANNELS + HAPSIM_BOARD_DIGITAL_WORD) /* of a frame with lines */
#elif defined HAPSIM_BOARD_SPEED_LIMIT
#define HAPSIM_HOST_WORDS (2 * HAPSIM_BOARD_CHANNELS + HAPSIM_BOARD_DIGITAL_WORD) /* of a frame with commands */
#elif HAPSIM_BOARD_CHANNELS + HAPSIM_BOARD_DIGITAL_WORD > 16
#define HAPSIM_HOST_WORDS (HAPSIM_BOARD_CHANNELS + HAPSIM_BOARD_DIGITAL_WORD)
#endif
#include "hapsim_device.h"
#include "hapsim_port.h"

#define CHANNELS HAPSIM_BOARD_CHANNELS

/* A board that senses accelerations defines HAPSIM_BOARD_ACCELERATION_SCALE, one that senses the force of the hand
 * HAPSIM_BOARD_HAND_FORCE_SCALE and _RANGE; no other pays for them. */
#ifdef HAPSIM_BOARD_ACCELERATION_SCALE
#define SENSES_ACCELERATION HAPSIM_SENSES_ACCELERATION
#else
#define SENSES_ACCELERATION 0
#endif
#ifdef HAPSIM_BOARD_HAND_FORCE_SCALE
#define SENSES_FORCE HAPSIM_SENSES_FORCE
#else
#define SENSES_FORCE 0
#endif
#define WORDS ((2 + !!SENSES_ACCELERATION + !!SENSES_FORCE) * CHANNELS + HAPSIM_BOARD_DIGITAL_WORD) /* with all parts */

#if HAPSIM_BOARD_CHANNELS < 1 || HAPSIM_BOARD_CHANNELS > 16
#error "HAPSIM_BOARD_CHANNELS: the protocol carries 1 to 16 channels"
#endif
#ifndef HAPSIM_BOARD_ROTARY
#define HAPSIM_BOARD_ROTARY 0 /* bit c: channel c turns; 0: not declared */
#endif
#ifndef HAPSIM_BOARD_BRIDGE
#define HAPSIM_BOARD_BRIDGE 0 /* 1: the actuators are behind another protocol */
#endif
#if HAPSIM_BOARD_DIGITAL_WORD & ~1
#error "HAPSIM_BOARD_DIGITAL_WORD: 0 or 1"
#endif
#if HAPSIM_BOARD_PACINGS & ~3
#error "HAPSIM_BOARD_PACINGS: bit 0 (device) and bit 1 (host); lockstep is not for a device with a motor"
#endif
#if HAPSIM_BOARD_MAX_WATCHDOG < 1 || HAPSIM_BOARD_MAX_WATCHDOG > 2047
#error "HAPSIM_BOARD_MAX_WATCHDOG: 1 to 2047 samples, so that an age is never ambiguous"
#endif
#if HAPSIM_BOARD_PERIOD_TICKS < 1 || HAPSIM_BOARD_PERIOD_TICKS > 1000000
#error "HAPSIM_BOARD_PERIOD_TICKS: 2048 periods have to fit 31 bits of the clock; choose a slower one"
#endif

/* A board that follows lines defines HAPSIM_BOARD_STEPS, its local periods in a sample, and more (PORTING.md); no other
 * pays for them. Its step may interrupt the tick, so what both use is volatile. */
#ifdef HAPSIM_BOARD_STEPS
#ifndef HAPSIM_BOARD_WINDOW
#define HAPSIM_BOARD_WINDOW HAPSIM_BOARD_STEPS
#endif
#ifndef HAPSIM_BOARD_KEPT
#define HAPSIM_BOARD_KEPT 32
#endif
#if HAPSIM_BOARD_STEPS < 1 || HAPSIM_BOARD_STEPS > 255 || HAPSIM_BOARD_WINDOW < 1 || HAPSIM_BOARD_WINDOW > 255
#error "HAPSIM_BOARD_STEPS, HAPSIM_BOARD_WINDOW: 1 to 255 local periods"
#endif
#if HAPSIM_BOARD_KEPT < 1 || HAPSIM_BOARD_KEPT > 128 || (HAPSIM_BOARD_KEPT & (HAPSIM_BOARD_KEPT - 1))
#error "HAPSIM_BOARD_KEPT: a power of two up to 128, so that sample numbers may wrap"
#endif
#define FOLLOWS HAPSIM_FOLLOWS_LINES
#define SHARED volatile
#define ALONG_LINE (device.format.parts & HAPSIM_WITH_LINE)
#else
#define FOLLOWS 0
#define SHARED
#define ALONG_LINE false
#endif

/* A board whose servo follows position commands defines HAPSIM_BOARD_SPEED_LIMIT and more (PORTING.md); no other pays for
 * them. */
#ifdef HAPSIM_BOARD_SPEED_LIMIT
#if defined HAPSIM_BOARD_STEPS || HAPSIM_BOARD_IMPULSE
#error "HAPSIM_BOARD_SPEED_LIMIT: a board that follows position commands follows no lines and gives no impulses"
#endif
#if HAPSIM_BOARD_HOLD_SAMPLES < 1 || HAPSIM_BOARD_HOLD_SAMPLES > 65535
#error "HAPSIM_BOARD_HOLD_SAMPLES: the samples of half a second or fewer, 1 to 65535"
#endif
#define SERVES HAPSIM_FOLLOWS_COMMANDS
#define BY_COMMAND (device.format.parts & HAPSIM_WITH_COMMANDS)
#else
#define SERVES 0
#endif

static const hapsim_f64 rate = HAPSIM_BOARD_RATE;
static const hapsim_f64 position_scale[CHANNELS] = HAPSIM_BOARD_POSITION_SCALE;
static const hapsim_f64 force_scale[CHANNELS] = HAPSIM_BOARD_FORCE_SCALE;
static const hapsim_f64 force_limit[CHANNELS] = HAPSIM_BOARD_FORCE_LIMIT;
static const hapsim_f64 velocity_scale[CHANNELS] = HAPSIM_BOARD_VELOCITY_SCALE;
#ifdef HAPSIM_BOARD_ACCELERATION_SCALE
static const hapsim_f64 acceleration_scale[CHANNELS] = HAPSIM_BOARD_ACCELERATION_SCALE;
#endif
#ifdef HAPSIM_BOARD_HAND_FORCE_SCALE
static const hapsim_f64 hand_force_scale[CHANNELS] = HAPSIM_BOARD_HAND_FORCE_SCALE;
static const hapsim_f64 hand_force_range[CHANNELS] = HAPSIM_BOARD_HAND_FORCE_RANGE;
#endif
static const int32_t limit_counts[CHANNELS] = HAPSIM_BOARD_FORCE_LIMIT_COUNTS;
static const char name[4 * HAPSIM_NAME_WORDS + 1] = HAPSIM_BOARD_NAME;

/* Only the main loop uses the decoder. It shares everything else with the tick, which it holds off meanwhile. */
static hapsim_decoder decoder;

static struct {
    hapsim_format format; /* of the frames sent, and of those received from the next byte on */
    bool listen_anew;     /* the decoder has not switched to `format` yet */
    SHARED uint8_t state;
    uint8_t fault, pacing;
    uint32_t sample;   /* the current one; sample numbers wrap at 32 bits and are compared by difference */
    uint32_t answered; /* the sample that the newest accepted force answers */
    uint32_t expires;  /* the last sample in which that force may act */
    uint32_t heard;    /* the sample in which that force came */
    uint32_t heard_at; /* the time at which that force came */
    uint16_t lives;    /* how long that force may act by the clock, in periods */
    bool released;     /* paced by the host: the time to live ended within this sample */
    uint16_t watchdog;
    uint32_t accepted, held, expired, limited;
    int32_t force[CHANNELS]; /* the command of the current sample */
#if HAPSIM_BOARD_DIGITAL_WORD
    uint32_t outputs; /* of the newest accepted force */
#endif
} device;

#ifdef HAPSIM_BOARD_STEPS
typedef struct {
    int32_t force, low, high, position; /* counts; the position that it answers */
    int16_t stiffness;
    uint16_t damping;
} line;

typedef struct {
    uint32_t whole; /* of the force limit in counts, divided by 32767 */
    uint16_t rest;
} bound_unit;

static const int8_t line_shifts[CHANNELS][2] = HAPSIM_BOARD_LINE_SHIFTS; /* of stiffness and damping */
static const uint16_t largest[CHANNELS][2] = HAPSIM_BOARD_LARGEST;

static struct {
    bound_unit units[CHANNELS];
    line followed[CHANNELS];
    line arrived[CHANNELS];                    /* of the newest accepted FORCE */
    int32_t reported[HAPSIM_BOARD_KEPT][CHANNELS];
    int32_t past[HAPSIM_BOARD_WINDOW][CHANNELS]; /* positions, a ring of local periods */
    uint8_t now;                                 /* its newest place */
    int32_t next[CHANNELS];                      /* forces that act from the next local period on */
    int32_t measured[WORDS];                     /* at the tick */
    uint8_t step;                                /* local periods since the tick */
    bool fresh;                                  /* the line of the sample that ended came in time */
    SHARED uint8_t found;                        /* the fault that a measurement found; then no step acts any more */
} lines;
#endif

#ifdef HAPSIM_BOARD_SPEED_LIMIT
static const hapsim_f64 servo_registers[4][CHANNELS] = {HAPSIM_BOARD_SPEED_LIMIT, HAPSIM_BOARD_BRAKING,
                                                        HAPSIM_BOARD_BANDWIDTH, HAPSIM_BOARD_SERVO_DAMPING};
static const int32_t most_per_sample[CHANNELS] = HAPSIM_BOARD_SPEED_LIMIT_COUNTS;
static const int32_t braking[CHANNELS] = HAPSIM_BOARD_BRAKING_COUNTS; /* 2^-8 counts per sample, each sample */

static struct {
    int32_t wanted[CHANNELS];  /* by the newest accepted FORCE, within the speed limit */
    int32_t command[CHANNELS]; /* that acts */
    int32_t speed[CHANNELS];   /* of it, 2^-8 counts per sample */
    uint8_t rest[CHANNELS];    /* 2^-8 counts more */
    uint16_t holds;            /* latched: samples until the torque ends, once the servo rests; 0: it has ended */
} servo;
#define END_SERVO() (servo.holds = 0)
#else
#define END_SERVO() ((void)0)
#endif

/* Ends the torque of a servo, too. */
static void put_zero(void) {
    END_SERVO();
    memset(device.force, 0, sizeof device.force);
    hapsim_port_put_forces(device.force);
}

#if HAPSIM_BOARD_DIGITAL_WORD
static void put_outputs(void) {
    if (device.format.parts & HAPSIM_WITH_WORDS) {
        hapsim_port_put_outputs(device.outputs);
    }
}

static void end_outputs(void) {
    device.outputs = 0;
    hapsim_port_put_outputs(0);
}

static void take_outputs(void) {
    if (device.format.parts & HAPSIM_WITH_WORDS) {
        device.outputs = (uint32_t)decoder.payload[hapsim_words_to_device(&decoder.format) - 1];
    }
}

/* The digital inputs stand behind everything else. */
static uint8_t measure(int32_t *counts, uint8_t parts) {
    const uint8_t fault = hapsim_port_measure(counts, parts);
    if (parts & HAPSIM_WITH_WORDS) {
        counts[hapsim_words_to_host(&device.format) - 1] = (int32_t)hapsim_port_read_inputs();
    }
    return fault;
}
#else
#define put_outputs() ((void)0)
#define end_outputs() ((void)0)
#define take_outputs() ((void)0)
#define measure hapsim_port_measure
#endif

/* What the device does whenever the host commands it no longer. */
static void put_nothing(void) {
    put_zero();
    end_outputs();
}

#ifdef HAPSIM_BOARD_SPEED_LIMIT
static bool brakes(uint8_t fault) {
    servo.holds = fault == HAPSIM_HOST_QUIET && BY_COMMAND ? HAPSIM_BOARD_HOLD_SAMPLES : 0;
    return servo.holds != 0;
}

/* Moves a command by its speed, within 32 bits. */
static void go_on(uint8_t c) {
    const int32_t moved = servo.speed[c] + servo.rest[c];
    const int64_t next = (int64_t)servo.command[c] + (moved >> 8);
    servo.rest[c] = (uint8_t)(moved & 255);
    servo.command[c] = next > INT32_MAX ? INT32_MAX : next < INT32_MIN ? INT32_MIN : (int32_t)next;
}

/* Returns true once every command rests. */
static bool brake(void) {
    bool rests = true;
    for (uint8_t c = 0; c < CHANNELS; c++) {
        const int32_t speed = servo.speed[c], less = braking[c];
        servo.speed[c] = speed > less ? speed - less : speed < -less ? speed + less : 0;
        rests = rests && servo.speed[c] == 0;
        go_on(c);
    }
    hapsim_port_put_commands(servo.command);
    return rests;
}

/* Latched, without its host: comes to rest, holds, and ends its torque. */
static void stop_servo(void) {
    if (servo.holds > 0 && brake() && --servo.holds == 0) {
        put_zero();
    }
}

/* Ends a sample: the command that answers it acts from now on. Without a new one the servo goes on at its speed; once the
 * time to live is over, it brakes. */
static void command_servo(bool heard) {
    if (!heard && (int32_t)(device.sample - device.expires) > 0) {
        (void)brake();
        return;
    }
    for (uint8_t c = 0; c < CHANNELS; c++) {
        if (heard) {
            servo.speed[c] = (servo.wanted[c] - servo.command[c]) * 256;
            servo.rest[c] = 0;
        }
        go_on(c);
    }
    hapsim_port_put_commands(servo.command);
}

/* Begins at rest, where the handle is. */
static void begin_servo(const int32_t *positions) {
    if (BY_COMMAND) {
        memset(&servo, 0, sizeof servo);
        memcpy(servo.command, positions, sizeof servo.command);
        hapsim_port_put_commands(servo.command);
    }
}

/* The host rounds to whole counts: so a step may be longer by one. */
static void take_commands(void) {
    for (uint8_t c = 0; BY_COMMAND && c < CHANNELS; c++) {
        const int64_t step = (int64_t)decoder.payload[CHANNELS + c] - servo.command[c], most = most_per_sample[c] + 1;
        const int64_t within_limit = step > most ? most : step < -most ? -most : step;
        device.limited += within_limit != step;
        servo.wanted[c] = (int32_t)(servo.command[c] + within_limit);
    }
}
#define BRAKES(fault) brakes(fault)
#define STOP_SERVO() stop_servo()
#else
#define BY_COMMAND false
#define BRAKES(fault) ((void)(fault), false)
#define STOP_SERVO() ((void)0)
#define command_servo(heard) ((void)(heard))
#define begin_servo(positions) ((void)(positions))
#define take_commands() ((void)0)
#endif

static void use_format(hapsim_format format) {
    device.format = format;
    device.listen_anew = true;
}

/* Sends a frame. Without room in the transmitter the frame is lost, as on a wire: nothing here waits. */
static void say(uint8_t type, uint32_t number, const int32_t *payload) {
    uint8_t out[1 + 2 + 4 * WORDS + 5 + 1];
    (void)hapsim_port_write(out, hapsim_write_to_host(&device.format, out, type, (uint16_t)(number & 0xFFFu), payload));
}

static void say_status(void) {
    int32_t payload[WORDS] = {0};
    payload[0] = (int32_t)(device.state | (uint16_t)device.fault << 8);
    say(HAPSIM_STATUS, device.sample, payload);
}

/* Sets the force to zero first; from the new state on no step acts. A servo without its host brakes instead. Sends STATUS
 * afterwards, in the armed format, which the host still expects. */
static void latch(uint8_t fault) {
    device.state = HAPSIM_LATCHED;
    if (!BRAKES(fault)) {
        put_zero();
    }
    end_outputs();
    device.fault = fault;
    say_status();
    use_format(hapsim_setup_format());
}

static void release(void) {
    put_nothing();
    device.state = HAPSIM_IDLE;
    use_format(hapsim_setup_format());
    say_status();
}

static void report(uint8_t type, uint8_t fault, const int32_t *payload) {
    if (fault != HAPSIM_NO_FAULT) {
        latch(fault);
    } else {
        say(type, device.sample, payload);
    }
}

static void say_position(uint8_t type) {
    int32_t payload[WORDS] = {0};
    const uint8_t fault = measure(payload, device.format.parts);
    if (device.sample == 0 && fault == HAPSIM_NO_FAULT) {
        begin_servo(payload);
    }
    report(type, fault, payload);
}

/* Ends the current sample: its command acts from now on, and the host receives the new measurement. */
static void end_sample(void) {
    const bool heard = device.heard == device.sample;
    const bool fresh = heard && device.answered == device.sample && !device.released;
    device.held += !fresh;
    if (BY_COMMAND) {
        command_servo(heard);
    } else {
        if (!heard && (HAPSIM_BOARD_IMPULSE || (int32_t)(device.sample - device.expires) > 0)) {
            memset(device.force, 0, sizeof device.force);
        }
        hapsim_port_put_forces(device.force);
    }
    put_outputs();
    device.sample++;
    say_position(fresh ? HAPSIM_POSITION : HAPSIM_POSITION_HELD);
}

/* While a pacing host is silent, no tick comes. So the device's own clock ends the force and checks the watchdog. */
static void look_at_clock(void) {
    if (device.state != HAPSIM_ARMED || device.pacing != HAPSIM_PACED_BY_HOST) {
        return;
    }
    const uint32_t quiet = hapsim_port_now() - device.heard_at;
    if (quiet >= (device.watchdog + 1ul) * HAPSIM_BOARD_PERIOD_TICKS) {
        latch(HAPSIM_HOST_QUIET);
    } else if (device.lives > 0 && quiet > (uint32_t)device.lives * HAPSIM_BOARD_PERIOD_TICKS) {
        device.lives = 0;
        device.released = true;
        put_zero();
    }
}

static int32_t within(int32_t force, int32_t limit) {
    if (force > limit || force < -limit) {
        device.limited++;
        return force > 0 ? limit : -limit;
    }
    return force;
}

#ifdef HAPSIM_BOARD_STEPS
static int32_t less(int32_t from, int32_t what) { /* the difference, saturated */
    const int32_t difference = (int32_t)((uint32_t)from - (uint32_t)what);
    const int8_t was = (int8_t)(from >> 24), is = (int8_t)(difference >> 24); /* the signs, in one byte */
    return ((was ^ (int8_t)(what >> 24)) & (was ^ is)) < 0 ? (was < 0 ? INT32_MIN : INT32_MAX) : difference;
}

/* Returns (top * 2^16 + bottom) / 2^shift, rounded down and saturated. A right shift of a negative number keeps the sign
 * with all compilers of these boards. */
static inline int32_t shifted(int32_t top, uint16_t bottom, int8_t shift) {
    if (shift >= 16) {
        return top >> (shift - 16);
    }
    const uint32_t half = (uint32_t)1 << (15 + shift);
    if ((uint32_t)top + half >= 2 * half) {
        return top < 0 ? INT32_MIN : INT32_MAX;
    }
    return (int32_t)((uint32_t)top << (16 - shift) | (shift >= 0 ? (uint32_t)bottom >> shift : (uint32_t)bottom << -shift));
}

/* Apart, else avr-gcc multiplies 32 bits by 32. */
static HAPSIM_APART uint32_t times(uint16_t one, uint16_t other) {
    return (uint32_t)one * other;
}

/* Returns factor * way / 2^shift, in products that a small processor has. `negative`: the factor is less by 2^16. */
static inline int32_t shifted_product(uint16_t factor, bool negative, int32_t way, int8_t shift) {
    const uint32_t under = times(factor, (uint16_t)way);
    uint32_t top = times(factor, (uint16_t)((uint32_t)way >> 16)) + (under >> 16);
    if (way < 0) {
        top -= (uint32_t)factor << 16;
    }
    if (negative) {
        top -= (uint32_t)way;
    }
    return shifted((int32_t)top, (uint16_t)under, shift);
}

/* No sum needs more than 32 bits: where one saturates, it is beyond a bound. */
static inline int32_t line_force(const line *own, uint8_t c, int32_t x, int32_t before) {
    const int32_t u = less(own->force, shifted_product((uint16_t)own->stiffness, own->stiffness < 0, less(x, own->position), line_shifts[c][0]));
    if (u >= own->high) {
        return own->high;
    }
    if (u <= own->low) {
        return own->low;
    }
    const int32_t damped = less(u, shifted_product(own->damping, false, less(x, before), line_shifts[c][1]));
    return damped > own->high ? own->high : damped < own->low ? own->low : damped;
}

static bound_unit bound_unit_of(int32_t limit) {
    const bound_unit unit = {(uint32_t)limit / 32767, (uint16_t)(limit % 32767)};
    return unit;
}

/* Returns |bound| * limit / 32767, rounded down, with the bound's sign. */
static int32_t bound_in_counts(int16_t bound, const bound_unit *unit) {
    const uint16_t size = (uint16_t)(bound < -32767 ? 32767 : bound < 0 ? -bound : bound);
    const uint32_t rest = (uint32_t)size * unit->rest; /* of division by 2^15 - 1, not yet divided */
    const uint16_t whole = (uint16_t)(rest >> 15), more = (uint16_t)(whole + (uint16_t)(rest & 32767u));
    const int32_t counts = (int32_t)(size * unit->whole + whole + (more >= 32767u));
    return bound < 0 ? -counts : counts;
}

static int16_t high_half(int32_t word) {
    return (int16_t)(word >> 16);
}

static int16_t low_half(int32_t word) {
    const uint16_t half = (uint16_t)((uint32_t)word & 0xFFFFu);
    return (int16_t)(half < 0x8000u ? half : half - 0x10000l);
}

/* Takes the lines of a FORCE of this age. Returns false if a low is above its high. */
static bool take_lines(uint16_t age) {
    const int32_t *word = decoder.payload + CHANNELS;
    for (uint8_t c = 0; c < CHANNELS; c++) {
        if (high_half(word[2 * c + 1]) > low_half(word[2 * c + 1])) {
            decoder.form_errors++;
            return false;
        }
    }
    for (uint8_t c = 0; c < CHANNELS; c++, word += 2) {
        line *own = &lines.arrived[c];
        const uint16_t damping = (uint16_t)((uint32_t)word[0] & 0xFFFFu);
        own->force = decoder.payload[c];
        own->stiffness = (int16_t)within(high_half(word[0]), largest[c][0]);
        own->damping = damping;
        if (damping > largest[c][1]) {
            own->damping = largest[c][1];
            device.limited++;
        }
        own->low = bound_in_counts(high_half(word[1]), &lines.units[c]);
        own->high = bound_in_counts(low_half(word[1]), &lines.units[c]);
        own->position = lines.reported[(device.sample - age) % HAPSIM_BOARD_KEPT][c];
    }
    return true;
}

/* Ends the sample, whose line is followed from now on. */
static void begin_sample(void) {
    const bool heard = device.heard == device.sample;
    lines.fresh = heard && device.answered == device.sample;
    device.held += !lines.fresh;
    if (heard) {
        memcpy(lines.followed, lines.arrived, sizeof lines.followed);
    } else if ((int32_t)(device.sample - device.expires) > 0) {
        memset(lines.followed, 0, sizeof lines.followed);
    }
    for (uint8_t c = 0; !heard && c < CHANNELS; c++) {
        lines.followed[c].stiffness = lines.followed[c].stiffness < 0 ? 0 : lines.followed[c].stiffness;
    }
    device.sample++;
}

/* A local period begins: the force that the last one computed acts, and the next one is computed. */
static void follow(bool is_tick) {
    int32_t local[WORDS];
    int32_t *x = is_tick ? lines.measured : local;
    hapsim_port_put_forces(lines.next);
    if (is_tick) {
        begin_sample();
        put_outputs();
    }
    lines.found = measure(x, is_tick ? device.format.parts : 0);
    if (lines.found != HAPSIM_NO_FAULT) {
        memset(lines.next, 0, sizeof lines.next);
        hapsim_port_put_forces(lines.next);
        return;
    }
    lines.now = (uint8_t)(lines.now + 1u < HAPSIM_BOARD_WINDOW ? lines.now + 1u : 0u);
    for (uint8_t c = 0; c < CHANNELS; c++) {
        const int32_t force = line_force(&lines.followed[c], c, x[c], lines.past[lines.now][c]);
        lines.past[lines.now][c] = x[c];
        lines.next[c] = force;
        device.limited += force >= limit_counts[c] || force <= -limit_counts[c];
    }
    if (is_tick) {
        memcpy(lines.reported[device.sample % HAPSIM_BOARD_KEPT], x, sizeof lines.reported[0]);
    }
}

bool hapsim_device_step(void) {
    const bool is_tick = ++lines.step >= HAPSIM_BOARD_STEPS;
    if (is_tick) {
        lines.step = 0;
    }
    if (ALONG_LINE && device.state == HAPSIM_ARMED) {
        if (lines.found == HAPSIM_NO_FAULT) {
            follow(is_tick);
        } else if (is_tick) {
            begin_sample(); /* the tick latches */
        }
    }
    return is_tick;
}

/* Measures position 0, and begins without a line. */
static void begin_lines(void) {
    memset(&lines, 0, sizeof lines);
    if (!ALONG_LINE) {
        say_position(HAPSIM_POSITION);
        return;
    }
    for (uint8_t c = 0; c < CHANNELS; c++) {
        lines.units[c] = bound_unit_of(limit_counts[c]);
    }
    lines.found = measure(lines.measured, device.format.parts);
    for (uint8_t i = 0; i < HAPSIM_BOARD_WINDOW; i++) {
        memcpy(lines.past[i], lines.measured, sizeof lines.past[i]);
    }
    memcpy(lines.reported[0], lines.measured, sizeof lines.reported[0]);
    report(HAPSIM_POSITION, lines.found, lines.measured);
}
#define BEGIN() begin_lines()
#define END_SAMPLE() \
    (ALONG_LINE ? report(lines.fresh ? HAPSIM_POSITION : HAPSIM_POSITION_HELD, lines.found, lines.measured) : end_sample())
#define TAKE_LINES(age) (!ALONG_LINE || take_lines(age))
#define IS_KEPT(age) (!ALONG_LINE || (age) < HAPSIM_BOARD_KEPT)
#else
#define BEGIN() say_position(HAPSIM_POSITION)
#define END_SAMPLE() end_sample()
#define TAKE_LINES(age) true
#define IS_KEPT(age) true
#endif

static void take_force(void) {
    look_at_clock(); /* the main loop may not have called this yet */
    if (device.state != HAPSIM_ARMED) {
        return;
    }
    const uint16_t age = hapsim_age(device.sample, decoder.number);
    if (age > decoder.argument || !IS_KEPT(age)) {
        device.expired++;
        return;
    }
    if (!TAKE_LINES(age)) {
        return;
    }
    device.accepted++;
    device.answered = device.sample - age;
    device.expires = device.answered + decoder.argument;
    device.heard = device.sample;
    device.heard_at = hapsim_port_now();
    device.lives = (uint16_t)(decoder.argument + 1u);
    take_outputs();
    take_commands();
    for (uint8_t c = 0; !ALONG_LINE && !BY_COMMAND && c < CHANNELS; c++) {
        device.force[c] = within(decoder.payload[c], limit_counts[c]);
    }
    if (device.pacing == HAPSIM_PACED_BY_HOST) {
        end_sample();
        device.released = false;
    }
}

static bool senses(uint8_t parts) {
    const bool velocity = (velocity_scale[0].low | velocity_scale[0].high) != 0;
    return (velocity || !(parts & HAPSIM_WITH_VELOCITY)) &&
           (SENSES_ACCELERATION || !(parts & HAPSIM_WITH_ACCELERATION)) &&
           (SENSES_FORCE || !(parts & HAPSIM_WITH_FORCE)) && (FOLLOWS || !(parts & HAPSIM_WITH_LINE)) &&
           (SERVES || !(parts & HAPSIM_WITH_COMMANDS)) && (HAPSIM_BOARD_DIGITAL_WORD || !(parts & HAPSIM_WITH_WORDS));
}

static uint8_t refusal(void) {
    const uint8_t pacing = (uint8_t)(decoder.argument & ~HAPSIM_PART_BITS);
    if ((uint32_t)decoder.payload[0] != HAPSIM_SCHEMA_HASH) {
        return HAPSIM_WRONG_SCHEMA;
    }
    if (pacing > HAPSIM_PACED_BY_HOST || !(HAPSIM_BOARD_PACINGS >> pacing & 1) ||
        (pacing == HAPSIM_PACED_BY_HOST && (decoder.argument & (HAPSIM_WITH_LINE | HAPSIM_WITH_COMMANDS)))) {
        return HAPSIM_WRONG_PACING;
    }
    if (!senses(decoder.argument)) {
        return HAPSIM_WRONG_SENSING;
    }
    if (decoder.number < 1 || decoder.number > HAPSIM_BOARD_MAX_WATCHDOG) {
        return HAPSIM_WRONG_WATCHDOG;
    }
    return HAPSIM_NO_FAULT;
}

static void begin_counting(void) {
    device.sample = 0;
    device.answered = device.expires = device.heard = device.sample - 1;
    device.lives = 0;
    device.released = false;
    device.accepted = device.held = device.expired = device.limited = 0;
    decoder.crc_errors = decoder.length_errors = decoder.form_errors = 0;
}

static void arm(void) {
    device.fault = refusal();
    device.sample = 0;
    if (device.fault != HAPSIM_NO_FAULT) {
        say_status();
        return;
    }
    put_nothing();
    begin_counting();
    device.pacing = (uint8_t)(decoder.argument & ~HAPSIM_PART_BITS);
    device.watchdog = decoder.number;
    device.state = HAPSIM_ARMED;
    say_status();
    use_format(hapsim_armed_format(CHANNELS, decoder.argument & HAPSIM_PART_BITS));
    hapsim_port_begin();
    device.heard_at = hapsim_port_now();
    BEGIN();
}

static void describe(void) {
    const int32_t value = (int32_t)hapsim_device_register(decoder.number);
    say(HAPSIM_DESCRIPTION, decoder.number, &value);
}

static void act(void) {
    if (decoder.type == HAPSIM_DISARM) {
        release();
    } else if (device.state == HAPSIM_ARMED) {
        if (decoder.type == HAPSIM_FORCE) {
            take_force();
        }
    } else if (decoder.type == HAPSIM_ARM) {
        arm();
    } else if (decoder.type == HAPSIM_DESCRIBE) {
        describe();
    }
}

void hapsim_device_init(void) {
    memset(&device, 0, sizeof device);
    hapsim_decoder_init(&decoder);
    device.format = hapsim_setup_format();
    put_nothing();
}

static HAPSIM_APART void listen_anew(void) {
    hapsim_port_hold_tick();
    device.listen_anew = false;
    hapsim_use_format(&decoder, device.format);
    hapsim_port_let_tick();
}

static HAPSIM_APART void take_frame(void) {
    hapsim_port_hold_tick();
    if (!device.listen_anew) { /* else the tick latched while this frame was read: the frame's format is over */
        act();
    }
    hapsim_port_let_tick();
}

/* Most bytes take a short path: they complete no frame. Checking a whole frame takes long on a small processor, so the
 * tick may interrupt the check. */
void hapsim_device_take_byte(uint8_t byte) {
    if (device.listen_anew) {
        listen_anew();
    }
    if (hapsim_take_byte(&decoder, byte)) {
        take_frame();
    }
}

void hapsim_device_lost_bytes(void) {
    hapsim_use_format(&decoder, decoder.format);
}

void hapsim_device_tick(void) {
    hapsim_port_feed_watchdog();
    STOP_SERVO();
    if (device.state != HAPSIM_ARMED || device.pacing != HAPSIM_PACED_BY_DEVICE) {
        look_at_clock();
        return;
    }
    END_SAMPLE();
    /* The watchdog is checked last in the tick: position n goes out, then the STATUS after which no position
     * follows. */
    if (device.state == HAPSIM_ARMED && device.sample - device.heard > device.watchdog) {
        latch(HAPSIM_HOST_QUIET);
    }
}

bool hapsim_device_look(void) {
    hapsim_port_hold_tick();
    look_at_clock();
    const bool again = device.state == HAPSIM_ARMED && device.pacing == HAPSIM_PACED_BY_HOST;
    hapsim_port_let_tick();
    return again;
}

uint8_t hapsim_device_state(void) {
    return device.state;
}

static uint32_t half(const hapsim_f64 *value, uint16_t high) {
    return high ? value->high : value->low;
}

#if defined HAPSIM_BOARD_ACCELERATION_SCALE || defined HAPSIM_BOARD_HAND_FORCE_SCALE || defined HAPSIM_BOARD_STEPS || \
    defined HAPSIM_BOARD_SPEED_LIMIT
#define HAS_MORE
static uint32_t more_register(uint16_t number) {
    const uint16_t c = (uint16_t)(number - HAPSIM_REG_MORE) / HAPSIM_MORE_WORDS;
    const uint16_t field = (uint16_t)(number - HAPSIM_REG_MORE) % HAPSIM_MORE_WORDS;
    if (c >= CHANNELS) {
        return 0;
    }
#ifdef HAPSIM_BOARD_ACCELERATION_SCALE
    if (field < 2) {
        return half(&acceleration_scale[c], field);
    }
#endif
#ifdef HAPSIM_BOARD_HAND_FORCE_SCALE
    if (field >= HAPSIM_REG_HAND_FORCE_SCALE - HAPSIM_REG_MORE && field < HAPSIM_REG_SPEED_LIMIT - HAPSIM_REG_MORE) {
        const bool range = field >= HAPSIM_REG_HAND_FORCE_RANGE - HAPSIM_REG_MORE;
        return half(range ? &hand_force_range[c] : &hand_force_scale[c], field & 1u);
    }
#endif
#ifdef HAPSIM_BOARD_SPEED_LIMIT
    if (field >= HAPSIM_REG_SPEED_LIMIT - HAPSIM_REG_MORE) {
        return half(&servo_registers[(field - (HAPSIM_REG_SPEED_LIMIT - HAPSIM_REG_MORE)) / 2][c], field & 1u);
    }
#endif
#ifdef HAPSIM_BOARD_STEPS
    if (field == HAPSIM_REG_LINE_SHIFTS - HAPSIM_REG_MORE) {
        return (uint8_t)line_shifts[c][0] | (uint32_t)(uint8_t)line_shifts[c][1] << 8;
    }
    if (field == HAPSIM_REG_LARGEST - HAPSIM_REG_MORE) {
        return (uint32_t)largest[c][0] << 16 | largest[c][1];
    }
#endif
    return 0;
}
#endif

static uint32_t channel_register(uint16_t number) {
    const uint16_t c = (uint16_t)(number - HAPSIM_REG_CHANNEL) / HAPSIM_CHANNEL_WORDS;
    const uint16_t field = (uint16_t)(number - HAPSIM_REG_CHANNEL) % HAPSIM_CHANNEL_WORDS;
    if (c >= CHANNELS) {
        return 0;
    }
    switch (field & ~1u) {
    case HAPSIM_REG_POSITION_SCALE: return half(&position_scale[c], field & 1u);
    case HAPSIM_REG_FORCE_SCALE: return half(&force_scale[c], field & 1u);
    case HAPSIM_REG_FORCE_LIMIT: return half(&force_limit[c], field & 1u);
    default: return half(&velocity_scale[c], field & 1u);
    }
}

static uint32_t name_register(uint16_t number) {
    const char *at = name + 4 * (number - HAPSIM_REG_NAME);
    return (uint8_t)at[0] | (uint32_t)(uint8_t)at[1] << 8 | (uint32_t)(uint8_t)at[2] << 16 |
           (uint32_t)(uint8_t)at[3] << 24;
}

uint32_t hapsim_device_register(uint16_t number) {
#ifdef HAS_MORE
    if (number >= HAPSIM_REG_MORE) {
        return more_register(number);
    }
#endif
    if (number >= HAPSIM_REG_CHANNEL) {
        return channel_register(number);
    }
    if (number >= HAPSIM_REG_NAME && number < HAPSIM_REG_NAME + HAPSIM_NAME_WORDS) {
        return name_register(number);
    }
    switch (number) {
    case HAPSIM_REG_VERSION: return HAPSIM_VERSION;
    case HAPSIM_REG_SCHEMA: return HAPSIM_SCHEMA_HASH;
    case HAPSIM_REG_CHANNELS: return CHANNELS;
    case HAPSIM_REG_PACINGS: return HAPSIM_BOARD_PACINGS;
    case HAPSIM_REG_RATE: return rate.low;
    case HAPSIM_REG_RATE + 1: return rate.high;
    case HAPSIM_REG_MAX_WATCHDOG: return HAPSIM_BOARD_MAX_WATCHDOG;
    case HAPSIM_REG_FAULT: return device.fault;
    case HAPSIM_REG_ACCEPTED: return device.accepted;
    case HAPSIM_REG_REJECTED: return decoder.crc_errors + decoder.length_errors + decoder.form_errors;
    case HAPSIM_REG_HELD: return device.held;
    case HAPSIM_REG_EXPIRED: return device.expired;
    case HAPSIM_REG_LIMITED: return device.limited;
    case HAPSIM_REG_ROTARY: return HAPSIM_BOARD_ROTARY;
    case HAPSIM_REG_BRIDGE: return HAPSIM_BOARD_BRIDGE;
    case HAPSIM_REG_SENSORS: return SENSES_ACCELERATION | SENSES_FORCE | FOLLOWS | SERVES | HAPSIM_BOARD_DIGITAL_WORD * HAPSIM_HAS_DIGITAL_WORD;
#ifdef HAPSIM_BOARD_STEPS
    case HAPSIM_REG_BOARD_STEPS: return HAPSIM_BOARD_STEPS;
    case HAPSIM_REG_BOARD_DELAY: return 1;
    case HAPSIM_REG_BOARD_WINDOW: return HAPSIM_BOARD_WINDOW;
    case HAPSIM_REG_KEPT_REPORTS: return HAPSIM_BOARD_KEPT;
#endif
    default: return 0;
    }
}
