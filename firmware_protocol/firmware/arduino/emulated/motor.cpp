/* SPDX-License-Identifier: MIT */
/* The sketch as a Linux process. Its pins drive a rotor and sense it:
 *
 *     INERTIA dv/dt = FULL_FORCE duty - FRICTION v        FRICTION: of the bearing, and K^2/R of a voltage drive
 *
 * The rotor moves exactly, by one slice of the clock at a time. All of its numbers are guesses. */
#include <motor.ino>

#include "uno_pins.h"

#include <math.h>
extern "C" {
#include "hardware.h"
void on_systick(void);
}

static const double INERTIA = 2e-5, FRICTION = 5e-5 + 1.25e-4; /* kg m^2, N m s/rad */
static const double STEP = 1e-6 * SLICE_US;

static uint32_t slices;
static double angle, speed; /* rad, rad/s */
static int32_t edges;       /* that the encoder has given */
static int noted;

unsigned long micros() {
    return slices * SLICE_US;
}

static int32_t counts() {
    return (int32_t)floor(angle / TRAVEL * COUNTS);
}

int analogRead(uint8_t) {
    const int32_t reading = COUNTS / 2 + counts();
    return reading < 0 ? 0 : reading > COUNTS ? COUNTS : reading;
}

uint8_t TwoWire::endTransmission(bool) {
    return 0;
}

uint8_t TwoWire::requestFrom(uint8_t address, uint8_t count) {
    return address == 0x36 ? count : 0;
}

int TwoWire::read() {
    const uint32_t raw = (uint32_t)counts() & 4095;
    const uint8_t bytes[] = {0x20, (uint8_t)(raw >> 8), (uint8_t)raw}; /* status and raw angle, from register 0x0b */
    return bytes[(at++ - 0x0b) % 3];
}

/* Sets a signal; its change runs the interrupt. */
static void set_signal(int pin, int level) {
    const bool changes = levels[pin] != level;
    levels[pin] = level;
    if (changes) {
        handlers[pin - 2]();
    }
}

static void give_edges() {
    while (edges != counts()) {
        edges += edges < counts() ? 1 : -1;
        set_signal(SENSOR_PIN_A, ((edges + 1) >> 1) & 1); /* A leads B forwards */
        set_signal(SENSOR_PIN_B, (edges >> 1) & 1);
    }
}

static void move() {
    const double force = FULL_FORCE * drive() / PWM_TOP, kept = exp(-FRICTION / INERTIA * STEP);
    const double reached = force / FRICTION, before = speed;
    speed = reached + (before - reached) * kept;
    angle += reached * STEP + (before - reached) * (1 - kept) * INERTIA / FRICTION;
}

void on_systick(void) {
    slices++;
    if (drive() != noted) {
        noted = drive();
        note_force(micros(), noted);
    }
    move();
    if (SENSOR == ENCODER) {
        give_edges();
    }
}
