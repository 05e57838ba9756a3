/* SPDX-License-Identifier: MIT */
/* The pins of a program that is the sketch, included after it: they keep what the sketch writes. Both inputs of a
 * bridge at once, or a change of direction under power, abort the program. */
#ifndef UNO_PINS_H
#define UNO_PINS_H

#include <Wire.h>
#include <stdlib.h>

static int duties[32], levels[32];
static bool has_duty[32];
static void (*handlers[2])(void);
static uint8_t at; /* the register that the AS5600 sends next */
TwoWire Wire;

void pinMode(uint8_t, uint8_t) {}
void noInterrupts() {}
void interrupts() {}

void digitalWrite(uint8_t pin, uint8_t level) {
    if (DRIVER == PWM_AND_DIRECTION && pin == MOTOR_PIN_B && level != levels[pin] && duties[MOTOR_PIN_A]) {
        abort();
    }
    levels[pin] = level;
}

int digitalRead(uint8_t pin) {
    return levels[pin];
}

void analogWrite(uint8_t pin, int duty) {
    duties[pin] = duty;
    has_duty[pin] = true;
    if (DRIVER == TWO_PWMS && duties[MOTOR_PIN_A] && duties[MOTOR_PIN_B]) {
        abort();
    }
}

/* As on an ESP32: a pin without a duty takes no frequency. */
void analogWriteFrequency(uint8_t pin, uint32_t) {
    if (!has_duty[pin]) {
        abort();
    }
}

void attachInterrupt(uint8_t number, void (*handler)(void), int) {
    handlers[number] = handler;
}

void TwoWire::setWireTimeout(uint32_t, bool) {}

void TwoWire::beginTransmission(uint8_t) {
    at = 0;
}

/* The first byte is the register; those that follow go into it. */
size_t TwoWire::write(uint8_t byte) {
    at = at ? at : byte;
    return 1;
}

/* Returns the duty, positive towards larger positions. */
static int drive() {
    return DRIVER == TWO_PWMS      ? duties[MOTOR_PIN_A] - duties[MOTOR_PIN_B]
           : levels[MOTOR_PIN_B] ? duties[MOTOR_PIN_A]
                                   : -duties[MOTOR_PIN_A];
}

#endif
