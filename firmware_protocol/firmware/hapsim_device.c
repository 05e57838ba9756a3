/* SPDX-License-Identifier: MIT */
#include "hapsim_device.h"

#include "hapsim_board.h"
#include "hapsim_port.h"

#define CHANNELS HAPSIM_BOARD_CHANNELS

/* A board that senses accelerations defines HAPSIM_BOARD_ACCELERATION_SCALE; no other pays for them. */
#ifdef HAPSIM_BOARD_ACCELERATION_SCALE
#define SENSED HAPSIM_SENSES_ACCELERATION
#define WORDS (3 * CHANNELS) /* of the longest payload: positions, velocities and accelerations */
#else
#define SENSED 0
#define WORDS (2 * CHANNELS)
#endif

#if HAPSIM_BOARD_CHANNELS < 1 || HAPSIM_BOARD_CHANNELS > 16
#error "HAPSIM_BOARD_CHANNELS: the protocol carries 1 to 16 channels"
#endif
#ifndef HAPSIM_BOARD_ROTARY
#define HAPSIM_BOARD_ROTARY 0 /* bit c: channel c turns; 0: not declared */
#endif
#ifndef HAPSIM_BOARD_BRIDGE
#define HAPSIM_BOARD_BRIDGE 0 /* 1: the actuators are behind another protocol */
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

static const hapsim_f64 rate = HAPSIM_BOARD_RATE;
static const hapsim_f64 position_scale[CHANNELS] = HAPSIM_BOARD_POSITION_SCALE;
static const hapsim_f64 force_scale[CHANNELS] = HAPSIM_BOARD_FORCE_SCALE;
static const hapsim_f64 force_limit[CHANNELS] = HAPSIM_BOARD_FORCE_LIMIT;
static const hapsim_f64 velocity_scale[CHANNELS] = HAPSIM_BOARD_VELOCITY_SCALE;
#ifdef HAPSIM_BOARD_ACCELERATION_SCALE
static const hapsim_f64 acceleration_scale[CHANNELS] = HAPSIM_BOARD_ACCELERATION_SCALE;
#endif
static const int32_t limit_counts[CHANNELS] = HAPSIM_BOARD_FORCE_LIMIT_COUNTS;
static const char name[4 * HAPSIM_NAME_WORDS + 1] = HAPSIM_BOARD_NAME;

/* Only the main loop uses the decoder. It shares everything else with the tick, which it holds off meanwhile. */
static hapsim_decoder decoder;

static struct {
    hapsim_format format; /* of the frames sent, and of those received from the next byte on */
    bool listen_anew;     /* the decoder has not switched to `format` yet */
    uint8_t state, fault, pacing;
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
} device;

static void put_zero(void) {
    memset(device.force, 0, sizeof device.force);
    hapsim_port_put_forces(device.force);
}

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

/* Sets the force to zero first. Sends STATUS afterwards, in the armed format, which the host still expects. */
static void latch(uint8_t fault) {
    put_zero();
    device.state = HAPSIM_LATCHED;
    device.fault = fault;
    say_status();
    use_format(hapsim_setup_format());
}

static void release(void) {
    put_zero();
    device.state = HAPSIM_IDLE;
    use_format(hapsim_setup_format());
    say_status();
}

static void say_position(uint8_t type) {
    int32_t payload[WORDS] = {0};
    const uint8_t fault = hapsim_port_measure(payload, device.format.parts);
    if (fault != HAPSIM_NO_FAULT) {
        latch(fault);
    } else {
        say(type, device.sample, payload);
    }
}

/* Ends the current sample: its command acts from now on, and the host receives the new measurement. */
static void end_sample(void) {
    const bool heard = device.heard == device.sample;
    const bool fresh = heard && device.answered == device.sample && !device.released;
    device.held += !fresh;
    if (!heard && (HAPSIM_BOARD_IMPULSE || (int32_t)(device.sample - device.expires) > 0)) {
        memset(device.force, 0, sizeof device.force);
    }
    hapsim_port_put_forces(device.force);
    device.sample++;
    say_position(fresh ? HAPSIM_POSITION : HAPSIM_POSITION_HELD);
}

/* While a pacing host is silent, no tick comes. So the device's own clock ends the force and checks the watchdog. */
static void look_at_clock(void) {
    const uint32_t quiet = hapsim_port_now() - device.heard_at;
    if (device.state != HAPSIM_ARMED || device.pacing != HAPSIM_PACED_BY_HOST) {
        return;
    }
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

static void take_force(void) {
    look_at_clock(); /* the main loop may not have called this yet */
    if (device.state != HAPSIM_ARMED) {
        return;
    }
    const uint16_t age = hapsim_age(device.sample, decoder.number);
    if (age > decoder.argument) {
        device.expired++;
        return;
    }
    device.accepted++;
    device.answered = device.sample - age;
    device.expires = device.answered + decoder.argument;
    device.heard = device.sample;
    device.heard_at = hapsim_port_now();
    device.lives = (uint16_t)(decoder.argument + 1u);
    for (uint8_t c = 0; c < CHANNELS; c++) {
        device.force[c] = within(decoder.payload[c], limit_counts[c]);
    }
    if (device.pacing == HAPSIM_PACED_BY_HOST) {
        end_sample();
        device.released = false;
    }
}

static bool senses(uint8_t parts) {
    const bool velocity = (velocity_scale[0].low | velocity_scale[0].high) != 0;
    return (velocity || !(parts & HAPSIM_WITH_VELOCITY)) && (SENSED || !(parts & HAPSIM_WITH_ACCELERATION)) &&
           !(parts & HAPSIM_WITH_LINE);
}

static uint8_t refusal(void) {
    const uint8_t pacing = (uint8_t)(decoder.argument & ~HAPSIM_PART_BITS);
    if ((uint32_t)decoder.payload[0] != HAPSIM_SCHEMA_HASH) {
        return HAPSIM_WRONG_SCHEMA;
    }
    if (pacing > HAPSIM_PACED_BY_HOST || !(HAPSIM_BOARD_PACINGS >> pacing & 1)) {
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
    put_zero();
    begin_counting();
    device.pacing = (uint8_t)(decoder.argument & ~HAPSIM_PART_BITS);
    device.watchdog = decoder.number;
    device.state = HAPSIM_ARMED;
    say_status();
    use_format(hapsim_armed_format(CHANNELS, decoder.argument & HAPSIM_PART_BITS));
    hapsim_port_begin();
    device.heard_at = hapsim_port_now();
    say_position(HAPSIM_POSITION);
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
    put_zero();
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
    if (device.state != HAPSIM_ARMED || device.pacing != HAPSIM_PACED_BY_DEVICE) {
        look_at_clock();
        return;
    }
    end_sample();
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

#ifdef HAPSIM_BOARD_ACCELERATION_SCALE
static uint32_t more_register(uint16_t number) {
    const uint16_t c = (uint16_t)(number - HAPSIM_REG_MORE) / HAPSIM_MORE_WORDS;
    const uint16_t field = (uint16_t)(number - HAPSIM_REG_MORE) % HAPSIM_MORE_WORDS;
    return c < CHANNELS && field < 2 ? half(&acceleration_scale[c], field) : 0;
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
#ifdef HAPSIM_BOARD_ACCELERATION_SCALE
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
    case HAPSIM_REG_SENSORS: return SENSED;
    default: return 0;
    }
}
