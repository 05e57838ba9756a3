/* SPDX-License-Identifier: MIT */
/* The port layer (hapsim_port.h) of any board with an Arduino core, and the state machine. Include this once, after the
 * sketch's constants. The state machine is compiled here too, because a library's own files do not see a sketch's
 * constants.
 *
 * There is one context. loop() calls the tick when micros() says so, and takes the bytes; an interrupt counts an
 * encoder. So loop() must do nothing else: a round must take far less than a sample. */
#ifndef HAPSIM_MOTOR_H
#define HAPSIM_MOTOR_H

#include <Arduino.h>

#define NO_PIN -1
#define ENCODER 1
#define AS5600 2
#define POTENTIOMETER 3
#define PWM_AND_DIRECTION 1
#define TWO_PWMS 2
#define ROTARY 1
#define LINEAR 2

#if SENSOR != ENCODER && SENSOR != AS5600 && SENSOR != POTENTIOMETER
#error "SENSOR: ENCODER, AS5600 or POTENTIOMETER"
#endif
#if DRIVER != PWM_AND_DIRECTION && DRIVER != TWO_PWMS
#error "DRIVER: PWM_AND_DIRECTION or TWO_PWMS"
#endif
#if MOTION != ROTARY && MOTION != LINEAR
#error "MOTION: ROTARY or LINEAR"
#endif

extern "C" {
#include "../extras/device/hapsim_device.h"
#include "../extras/device/hapsim_port.h"
}
#include "hapsim_board.h"
extern "C" {
#include "../extras/device/hapsim_device.c"
}
#if SENSOR == AS5600
#include <Wire.h>
#endif
#ifdef __AVR__
#include <avr/wdt.h>
#endif

static uint32_t hapsim_due;     /* the next tick, in us */
static bool hapsim_sensed;      /* the sensor was read in this sample */
static int32_t hapsim_position; /* counts, before POSITION_SIGN */
static bool hapsim_wrong;       /* the sensor: since arming (ENCODER), or at its last two readings */

#if SENSOR == ENCODER
static volatile int32_t hapsim_edges;
static volatile bool hapsim_missed; /* both signals had changed: an interrupt came too late */
static volatile uint8_t hapsim_signals;

#ifdef __AVR__ /* there digitalRead takes longer than all the rest */
static volatile uint8_t *hapsim_inputs[2];
static uint8_t hapsim_masks[2];
static inline uint8_t hapsim_level(uint8_t signal) {
    return (*hapsim_inputs[signal] & hapsim_masks[signal]) != 0;
}
#else
static inline uint8_t hapsim_level(uint8_t signal) {
    return digitalRead(signal ? SENSOR_PIN_B : SENSOR_PIN_A) != 0;
}
#endif

#ifndef IRAM_ATTR /* an ESP32 and an ESP8266 keep interrupts in RAM */
#define IRAM_ATTR
#endif

static void IRAM_ATTR hapsim_on_edge() {
    const uint8_t before = hapsim_signals, now = (uint8_t)(hapsim_level(0) | hapsim_level(1) << 1);
    hapsim_signals = now;
    if ((before ^ now) == 3) {
        hapsim_missed = true;
    } else if (before != now) {
        hapsim_edges = hapsim_edges + (((before ^ now >> 1) & 1) ? -1 : 1); /* A leads B: forwards */
    }
}

static void hapsim_start_sensor() {
#ifdef __AVR__
    const int pins[2] = {SENSOR_PIN_A, SENSOR_PIN_B};
    for (uint8_t i = 0; i < 2; i++) {
        hapsim_inputs[i] = portInputRegister(digitalPinToPort(pins[i]));
        hapsim_masks[i] = digitalPinToBitMask(pins[i]);
    }
#endif
    pinMode(SENSOR_PIN_A, INPUT_PULLUP);
    pinMode(SENSOR_PIN_B, INPUT_PULLUP);
    hapsim_signals = (uint8_t)(hapsim_level(0) | hapsim_level(1) << 1);
    attachInterrupt(digitalPinToInterrupt(SENSOR_PIN_A), hapsim_on_edge, CHANGE);
    attachInterrupt(digitalPinToInterrupt(SENSOR_PIN_B), hapsim_on_edge, CHANGE);
}

static void hapsim_sense() {
    noInterrupts();
    hapsim_position = hapsim_edges;
    hapsim_wrong = hapsim_missed;
    interrupts();
}

static void hapsim_forgive() {
    hapsim_missed = false;
}
#else
static int32_t hapsim_last;
static uint8_t hapsim_odd = 2; /* bad readings in a row */

#if SENSOR == AS5600
enum { AS5600_ADDRESS = 0x36, AS5600_FILTER = 0x07, AS5600_STATUS = 0x0b, AS5600_MAGNET = 0x20 };

/* Limits a transfer to 1 or 2 ms. Else a broken wire stops loop(), with the motor on: on an AVR for ever, on other cores
 * for 25 to 1000 ms. The compiler takes the function whose call the core has; the last one, where there is none. */
template <typename W> auto hapsim_limit(W &wire, int) -> decltype(wire.setWireTimeout(1, true)) { /* AVR: us */
    return wire.setWireTimeout(1000, true);
}
template <typename W> auto hapsim_limit(W &wire, int) -> decltype(wire.setTimeOut(2)) { /* ESP32: ticks of 1 ms */
    return wire.setTimeOut(2);
}
template <typename W> auto hapsim_limit(W &wire, int) -> decltype(wire.setTimeout(1, true)) { /* RP2040: ms */
    return wire.setTimeout(1, true);
}
template <typename W> void hapsim_limit(W &, ...) {}

static void hapsim_start_sensor() {
    Wire.begin();
    Wire.setClock(400000);
    hapsim_limit(Wire, 0);
    Wire.beginTransmission(AS5600_ADDRESS);
    Wire.write((uint8_t)AS5600_FILTER);
    Wire.write((uint8_t)3); /* the fastest slow filter: 0.29 ms instead of 2.2 ms */
    Wire.endTransmission();
}

/* Reads status and raw angle. Returns false without an answer or a magnet. */
static bool hapsim_read(int32_t *reading) {
    Wire.beginTransmission(AS5600_ADDRESS);
    Wire.write((uint8_t)AS5600_STATUS);
    if (Wire.endTransmission(false) != 0 || Wire.requestFrom((uint8_t)AS5600_ADDRESS, (uint8_t)3) != 3) {
        return false;
    }
    const int status = Wire.read(), high = Wire.read(), low = Wire.read();
    *reading = (high & 15) << 8 | low;
    return (status & AS5600_MAGNET) != 0;
}

static int32_t hapsim_step_to(int32_t reading) {
    return ((reading - hapsim_last + COUNTS / 2) & (COUNTS - 1)) - COUNTS / 2;
}
#else
static void hapsim_start_sensor() {}

/* Returns false near both ends, where a wire is off. */
static bool hapsim_read(int32_t *reading) {
    *reading = analogRead(SENSOR_PIN_A);
    return *reading > COUNTS / 256 && *reading < COUNTS - COUNTS / 256;
}

static int32_t hapsim_step_to(int32_t reading) {
    return reading - hapsim_last;
}
#endif

/* Skips one bad reading: none, or an eighth of COUNTS from the last. The second in a row is a fault. Afterwards goes on
 * from the present reading. */
static void hapsim_sense() {
    int32_t reading = hapsim_last;
    const bool answered = hapsim_read(&reading);
    const int32_t step = hapsim_step_to(reading);
    const bool good = answered && step <= COUNTS / 8 && step >= -COUNTS / 8;
    hapsim_odd = good ? 0 : hapsim_odd < 2 ? hapsim_odd + 1 : 2;
    if (good) {
        hapsim_position += step;
    }
    if (good || (answered && hapsim_odd > 1)) {
        hapsim_last = reading;
    }
#if SENSOR == POTENTIOMETER
    hapsim_position = hapsim_last - COUNTS / 2;
#endif
    hapsim_wrong = hapsim_odd > 1;
}

static void hapsim_forgive() {}
#endif

/* A timer of an AVR gives 62.5 kHz: fast PWM of 8 bits without a prescaler. The core's 490 Hz would be slower than the
 * samples. Other boards: PWM_SETUP. */
static void hapsim_start_pwm(int pin) {
    (void)pin;
#define HAPSIM_FAST(n) TCCR##n##A |= _BV(WGM##n##0), TCCR##n##B = _BV(WGM##n##2) | _BV(CS##n##0)
#ifdef TCCR1A /* not the newer AVRs, such as the Nano Every's */
    switch (digitalPinToTimer(pin)) {
    case TIMER1A:
    case TIMER1B: HAPSIM_FAST(1); break;
#ifdef TCCR2A
    case TIMER2A:
    case TIMER2B:
        TCCR2A |= _BV(WGM21) | _BV(WGM20);
        TCCR2B = _BV(CS20);
        break;
#endif
#ifdef TCCR3A
    case TIMER3A:
    case TIMER3B:
    case TIMER3C: HAPSIM_FAST(3); break;
#endif
#ifdef TCCR5A /* a Mega; timer 4 of a Leonardo is of another kind */
    case TIMER4A:
    case TIMER4B:
    case TIMER4C: HAPSIM_FAST(4); break;
    case TIMER5A:
    case TIMER5B:
    case TIMER5C: HAPSIM_FAST(5); break;
#endif
    }
#endif
}

/* Fast PWM of 8 bits lasts one step longer than its register says, and analogWrite(pin, 0) turns it off. So a single
 * step of 256 is not to be had. */
#ifdef TCCR1A
enum { HAPSIM_DUTIES = PWM_TOP + 1, HAPSIM_LEAST_DUTY = 2, HAPSIM_LONGER = 1 };
#else
enum { HAPSIM_DUTIES = PWM_TOP, HAPSIM_LEAST_DUTY = 1, HAPSIM_LONGER = 0 };
#endif

/* Returns the signed duty, at most that of the force limit. What rounding takes off a force comes with the next one, so
 * that a weak spring has no dead zone. A force of zero is zero. */
static int hapsim_duty(int32_t force) {
    static int32_t rest;
    const int32_t top = (limit_counts[0] * HAPSIM_DUTIES + HAPSIM_FORCE_COUNTS / 2) / HAPSIM_FORCE_COUNTS;
    const int32_t wanted = force ? force * HAPSIM_DUTIES + rest : 0;
    const int32_t half = wanted < 0 ? -HAPSIM_FORCE_COUNTS / 2 : HAPSIM_FORCE_COUNTS / 2;
    int32_t duty = (wanted + half) / HAPSIM_FORCE_COUNTS;
    if (duty > top || duty < -top) {
        rest = 0;
        return (int)(duty > 0 ? top : -top);
    }
    if (duty < HAPSIM_LEAST_DUTY && duty > -HAPSIM_LEAST_DUTY) {
        duty = 0;
    }
    rest = wanted - duty * HAPSIM_FORCE_COUNTS;
    return (int)duty;
}

/* Turns one side off before the other side on. */
static void hapsim_drive(bool forwards, int size) {
    const int duty = size ? size - HAPSIM_LONGER : 0;
#if DRIVER == TWO_PWMS
    analogWrite(forwards ? MOTOR_PIN_B : MOTOR_PIN_A, 0);
    analogWrite(forwards ? MOTOR_PIN_A : MOTOR_PIN_B, duty);
#else
    static bool before;
    if (forwards != before) {
        analogWrite(MOTOR_PIN_A, 0);
    }
    before = forwards;
    digitalWrite(MOTOR_PIN_B, forwards ? HIGH : LOW);
    analogWrite(MOTOR_PIN_A, duty);
#endif
}

uint32_t hapsim_port_now(void) {
    return (uint32_t)micros();
}

uint8_t hapsim_port_measure(int32_t *counts, uint8_t parts) {
    (void)parts;
    hapsim_sense();
    hapsim_sensed = true;
    counts[0] = POSITION_SIGN * hapsim_position;
    return hapsim_wrong ? HAPSIM_HARDWARE : HAPSIM_NO_FAULT;
}

void hapsim_port_put_forces(const int32_t *counts) {
    const int duty = hapsim_duty(FORCE_SIGN * counts[0]);
    hapsim_drive(duty > 0, duty < 0 ? -duty : duty);
}

/* On a core whose port never tells its room nothing is sent. */
bool hapsim_port_write(const uint8_t *bytes, size_t count) {
    return HOST_PORT.availableForWrite() >= (int)count && HOST_PORT.write(bytes, count) == count;
}

void hapsim_port_feed_watchdog(void) {
#ifdef __AVR__
    wdt_reset();
#endif
}

void hapsim_port_begin(void) {
    hapsim_due = hapsim_port_now() + HAPSIM_BOARD_PERIOD_TICKS;
    hapsim_forgive();
}

/* Not needed: there is one context. */
void hapsim_port_hold_tick(void) {}
void hapsim_port_let_tick(void) {}

static void hapsim_set_enable() {
    if (ENABLE_PIN != NO_PIN) {
        digitalWrite(ENABLE_PIN, hapsim_device_state() == HAPSIM_ARMED ? HIGH : LOW);
    }
}

/* Call it in setup(). */
static void hapsim_motor_begin() {
    const int pins[] = {ENABLE_PIN, MOTOR_PIN_A, MOTOR_PIN_B};
    for (int pin : pins) {
        if (pin != NO_PIN) {
            digitalWrite(pin, LOW);
            pinMode(pin, OUTPUT);
        }
    }
    hapsim_start_pwm(MOTOR_PIN_A);
    if (DRIVER == TWO_PWMS) {
        hapsim_start_pwm(MOTOR_PIN_B);
    }
    hapsim_device_init(); /* writes a duty of 0: an ESP32 takes a frequency only for a pin that has one */
    PWM_SETUP;
    hapsim_start_sensor();
    hapsim_sense();
    hapsim_sense(); /* the first reading sets the position */
    HOST_PORT.begin(BAUD_RATE);
    hapsim_port_begin();
#ifdef __AVR__
    wdt_enable(WDTO_60MS); /* resets the chip, and so the motor's pins, when loop() stands still */
#endif
}

static bool hapsim_is_due() {
    return (int32_t)(hapsim_port_now() - hapsim_due) >= 0;
}

static void hapsim_tick() {
    hapsim_due += HAPSIM_BOARD_PERIOD_TICKS;
    if (hapsim_is_due()) { /* loop() stood still: no burst of ticks */
        hapsim_due = hapsim_port_now() + HAPSIM_BOARD_PERIOD_TICKS;
    }
    hapsim_sensed = false;
    hapsim_device_tick();
    if (!hapsim_sensed) { /* in every state: an unread turn would be lost */
        hapsim_sense();
    }
}

/* Call it in loop(), and nothing else. */
static void hapsim_motor_loop() {
    if (hapsim_is_due()) {
        hapsim_tick();
    }
    while (!hapsim_is_due() && HOST_PORT.available() > 0) {
        hapsim_device_take_byte((uint8_t)HOST_PORT.read());
    }
    (void)hapsim_device_look();
    hapsim_set_enable();
}

#endif
