/* SPDX-License-Identifier: MIT */
/* The sketch of examples/knob on the emulated Cortex-M3, and as a Linux process. Its motor turns the mass of
 * simulated_mass.c: 1 nm there is 0.1 urad here.
 *
 *     torque = K (U - K speed) / R         R: from the firmware of a NanoD++; K: a guess
 *
 * The rotor moves once per tick, in the first round of the FOC after the tick. It moves by the whole next sample, under
 * the voltage that this round puts out and holds. So the position at a tick is exact, without the delay that the FOC
 * loop of a real board adds. */
#include <Arduino.h>
#include <SimpleFOC.h>
#include <math.h>

#include "hapsim_board.h"
#include "hapsim_knob.h"
#include "hapsim_platform.h"
extern "C" {
#include "hardware.h"
#include "simulated_mass.h"
void on_systick(void);
}

static const double RESISTANCE = 2.645, TORQUE_CONSTANT = 0.015; /* ohm, N m/A = V s/rad */
static const double TURN = 6.283185307179586;
static const double RAD = 1e-7 / (1 << 24);                       /* per unit of position of simulated_mass.h */
static const double NM_PER_COUNT = 6e-11;                         /* 1.2e-5 kg m^2 in place of its 0.2 kg */

static simulated_mass rotor;
static volatile uint32_t ticks;
static uint32_t moved;
static float applied; /* V */
static bool drives;   /* the driver is enabled; else no current flows, and nothing brakes */
static float sensed;  /* rad */
static bool runs;

void on_systick(void) {
    ticks = ticks + 1;
    if (runs) {
        hapsim_knob_tick();
    }
}

void hapsim_platform_begin(uint32_t) {
    runs = true;
}

void hapsim_platform_restart(uint32_t) {
    begin_period();
}

void hapsim_platform_feed_watchdog() {
    feed_watchdog();
}

unsigned long micros() {
    return now_us();
}

/* Applies a voltage. Logs each change as the torque at standstill, in counts of the wire. */
static void apply(bool enable, float volts) {
    drives = enable;
    if (volts != applied) {
        applied = volts;
        note_force(ticks * 1000, (int32_t)lround(volts * TORQUE_CONSTANT / RESISTANCE / HAPSIM_KNOB_NM_PER_COUNT));
    }
}

/* Moves the rotor up to now, and senses its angle within the turn, in 14 bits. */
static void move_rotor() {
    const int64_t turn = (int64_t)(TURN / RAD);
    for (; moved != ticks; moved++) {
        const double back_emf = TORQUE_CONSTANT * (double)rotor.velocity * RAD * 1000;
        const double current = drives ? (applied - back_emf) / RESISTANCE : 0;
        simulated_mass_move(&rotor, (int32_t)(TORQUE_CONSTANT * current / NM_PER_COUNT));
        const int64_t within = (rotor.position % turn + turn) % turn;
        sensed = (float)((double)(within * 16384 / turn) * (TURN / 16384));
    }
}

float MagneticSensorMT6701SSI::getSensorAngle() {
    return sensed;
}

int BLDCMotor::init() {
    enable();
    return 1;
}

int BLDCMotor::initFOC() {
    sensor_direction = Direction::CW;
    motor_status = FOCMotorStatus::motor_ready;
    return 1;
}

void BLDCMotor::enable() {
    enabled = 1;
    apply(true, 0);
}

void BLDCMotor::disable() {
    enabled = 0;
    apply(false, 0);
}

void BLDCMotor::move(float new_target) {
    if (enabled) {
        target = new_target;
    }
}

void BLDCMotor::loopFOC() {
    if (enabled) {
        apply(true, target);
    }
    move_rotor();
    sensor->update();
}
