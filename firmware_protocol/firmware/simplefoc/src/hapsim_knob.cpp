/* SPDX-License-Identifier: MIT */
#include "hapsim_knob.h"

#include <math.h>

#include "hapsim_board.h"
#include "hapsim_platform.h"
extern "C" {
#include "device/hapsim_device.h"
#include "device/hapsim_port.h"
}

static const int32_t RELEASED = INT32_MIN; /* the driver is disabled; no torque within the limit has this count */
static const int32_t limit_counts[] = HAPSIM_BOARD_FORCE_LIMIT_COUNTS;
static const uint32_t STALLED_TICKS = 5; /* ticks without a round of the FOC loop: the field stands still */

static FOCMotor *motor;
static Stream *port;
static float target_per_count;
static int64_t origin, newest;       /* angles in counts; only loop() uses them */
static uint32_t ticks_without_round; /* belongs to the state machine: the tick or a byte uses it */

/* Shared by both contexts, one word each. */
static int32_t wanted = RELEASED; /* to loop(): the torque in counts */
static int32_t shaft;             /* from loop(): the angle in counts */
static uint32_t rounds;           /* from loop(): its number of rounds */
static uint32_t fault;            /* from loop(): the present fault of motor or angle */
static uint32_t jumped;           /* from loop(): 1 if the angle has jumped since arming */

/* All accesses are sequentially consistent, because each side writes one of `due` and `busy` and then reads the
 * other. */
template <typename Word> static Word read_word(const Word &word) {
    return __atomic_load_n(&word, __ATOMIC_SEQ_CST);
}
template <typename Word, typename Value> static void write_word(Word &word, Value value) {
    __atomic_store_n(&word, (Word)value, __ATOMIC_SEQ_CST);
}

/* due: a tick must be done. busy: one side is in the state machine. */
static uint32_t due, busy;

static uint32_t take_word(uint32_t &word, uint32_t value) {
    return __atomic_exchange_n(&word, value, __ATOMIC_SEQ_CST);
}

static bool try_enter() {
    return !take_word(busy, 1);
}

/* The state decides whether the driver is enabled. A latch, a DISARM and a refused ARM put out zero before they change
 * the state. */
static void leave() {
    if (hapsim_device_state() != HAPSIM_ARMED) {
        write_word(wanted, RELEASED);
    } else if (read_word(wanted) == RELEASED) {
        write_word(wanted, 0);
    }
    write_word(busy, 0);
}

/* A side that finds the state machine busy has already written `due`. The side that leaves reads `due` afterwards. */
static void do_due_ticks() {
    while (read_word(due) && try_enter()) {
        if (take_word(due, 0)) {
            hapsim_device_tick();
        }
        leave();
    }
}

void hapsim_knob_tick() {
    write_word(due, 1);
    do_due_ticks();
}

/* Enters the state machine with a byte; with -1, lets it check the clock. */
static void enter_with(int byte) {
    while (!try_enter()) {
    }
    if (byte >= 0) {
        hapsim_device_take_byte((uint8_t)byte);
    } else {
        (void)hapsim_device_look();
    }
    leave();
    do_due_ticks();
}

/* SimpleFOC's angle within the turn is exact; its angle over all turns is a rounded float. initFOC found the
 * direction. */
static int64_t angle_in_counts(float within) {
    const int64_t turns = motor->sensor->getFullRotations();
    const int64_t counts = turns * HAPSIM_KNOB_TURN + lroundf(within * (HAPSIM_KNOB_TURN / 6.283185307f));
    return motor->sensor_direction == Direction::CCW ? -counts : counts;
}

static bool is_ready() {
    return motor->motor_status == FOCMotorStatus::motor_ready && target_per_count > 0;
}

/* Reads the angle. Returns the present fault. */
static uint32_t read_shaft() {
    const float within = motor->sensor->getMechanicalAngle();
    if (!is_ready() || !(fabsf(within) < 6.3f)) { /* NaN too */
        return HAPSIM_HARDWARE;
    }
    const int64_t before = newest;
    newest = angle_in_counts(within);
    if (newest - before > HAPSIM_KNOB_LARGEST_STEP || before - newest > HAPSIM_KNOB_LARGEST_STEP) {
        write_word(jumped, 1);
    }
    const int64_t counts = newest - origin;
    write_word(shaft, (int32_t)counts);
    return counts == (int32_t)counts ? HAPSIM_NO_FAULT : HAPSIM_POSITION_OUT_OF_RANGE;
}

/* Sets the torque first, so that this round puts it out. loopFOC reads the sensor in every state. */
static void run_foc() {
    const int32_t counts = read_word(wanted);
    const bool on = fault == HAPSIM_NO_FAULT && !read_word(jumped) && counts != RELEASED;
    if (on && !motor->enabled) {
        motor->enable();
    } else if (!on && motor->enabled) {
        motor->disable();
    }
    motor->move(on ? (float)counts * target_per_count : 0.0f);
    motor->loopFOC();
    write_word(fault, read_shaft());
    write_word(rounds, rounds + 1);
}

void hapsim_knob_loop() {
    run_foc();
    for (int count = port->available(); count > 0; count--) {
        enter_with(port->read());
    }
    enter_with(-1);
}

static float largest_target() {
    const bool in_volts = motor->torque_controller == TorqueControlType::voltage && !_isset(motor->phase_resistance);
    return in_volts ? motor->voltage_limit : motor->current_limit;
}

bool hapsim_knob_begin(FOCMotor &a_motor, Stream &a_port, float target_per_nm) {
    motor = &a_motor;
    port = &a_port;
    motor->disable();
    motor->controller = MotionControlType::torque;
    motor->motion_downsample = 0;
    const float per_count = target_per_nm * HAPSIM_KNOB_NM_PER_COUNT;
    const bool within = per_count > 0 && (float)limit_counts[0] * per_count <= largest_target(); /* NaN is not */
    target_per_count = within ? per_count : 0;
    motor->sensor->update();
    const float start = motor->sensor->getMechanicalAngle();
    origin = newest = isfinite(start) ? angle_in_counts(start) : 0;
    fault = read_shaft();
    hapsim_device_init();
    hapsim_platform_begin(HAPSIM_BOARD_PERIOD_TICKS);
    return is_ready();
}

uint32_t hapsim_port_now(void) {
    return micros();
}

/* A dead loop() cannot disable the driver. So the tick latches and no longer feeds the watchdog, whose reset disables
 * it. */
static bool loop_runs() {
    return ticks_without_round < STALLED_TICKS;
}

void hapsim_port_feed_watchdog(void) {
    static uint32_t seen;
    const uint32_t now = read_word(rounds);
    ticks_without_round = now == seen ? ticks_without_round + 1 : 0;
    seen = now;
    if (loop_runs()) {
        hapsim_platform_feed_watchdog();
    }
}

uint8_t hapsim_port_measure(int32_t *counts, uint8_t parts) {
    (void)parts;
    counts[0] = read_word(shaft);
    return (uint8_t)(read_word(jumped) || !loop_runs() ? (uint32_t)HAPSIM_HARDWARE : read_word(fault));
}

void hapsim_port_put_forces(const int32_t *counts) {
    write_word(wanted, hapsim_device_state() == HAPSIM_ARMED ? counts[0] : RELEASED);
}

bool hapsim_port_write(const uint8_t *bytes, size_t count) {
    return port->availableForWrite() >= (int)count && port->write(bytes, count) == count;
}

void hapsim_port_begin(void) {
    hapsim_platform_restart(HAPSIM_BOARD_PERIOD_TICKS);
    write_word(due, 0);
    write_word(jumped, 0);
}

/* Not needed: only one side at a time is in the state machine. */
void hapsim_port_hold_tick(void) {}
void hapsim_port_let_tick(void) {}
