/* The harness with the Arduino sketch for its board: what the harness calls of the state machine goes through loop() and
 * the port. Both inputs of a bridge at once, or a change of direction under power, abort it. */
extern "C" {
#include "hapsim_device.h"
}
#undef HAPSIM_F64
#define HAPSIM_F64(high, low) {low, high} /* of the harness's constants, in C++ */
#include <motor.ino>

#include "given_serial.h"

#include <Wire.h>
#include <stdio.h>
#include <stdlib.h>

static int duties[32], levels[32];
static void (*handlers[2])(void);
static int32_t reading = COUNTS / 2, phase;
static bool silent, no_magnet;
static const bool in_session = HAPSIM_FORCE_COUNTS == 1; /* which says when a tick comes, and places the encoder */
static uint8_t at;
TwoWire Wire;

unsigned long micros() {
    return now;
}

void pinMode(uint8_t, uint8_t) {}
void noInterrupts() {}
void interrupts() {}

static bool on(int pin) {
    return duties[pin] != 0;
}

void digitalWrite(uint8_t pin, uint8_t level) {
    if (DRIVER == PWM_AND_DIRECTION && pin == MOTOR_PIN_B && level != levels[pin] && on(MOTOR_PIN_A)) {
        abort();
    }
    levels[pin] = level;
}

int digitalRead(uint8_t pin) {
    return levels[pin];
}

void analogWrite(uint8_t pin, int duty) {
    duties[pin] = duty;
    if (DRIVER == TWO_PWMS && on(MOTOR_PIN_A) && on(MOTOR_PIN_B)) {
        abort();
    }
}

int analogRead(uint8_t) {
    return silent ? 0 : reading;
}

void attachInterrupt(uint8_t number, void (*handler)(void), int) {
    handlers[number] = handler;
}

void TwoWire::setWireTimeout(uint32_t, bool) {}

void TwoWire::beginTransmission(uint8_t) {
    at = 0;
}

size_t TwoWire::write(uint8_t byte) {
    at = at ? at : byte;
    return 1;
}

uint8_t TwoWire::endTransmission(bool) {
    return silent ? 2 : 0;
}

uint8_t TwoWire::requestFrom(uint8_t, uint8_t count) {
    return silent || at != 0x0b ? 0 : count;
}

int TwoWire::read() {
    const int bytes[] = {no_magnet ? 0x10 : 0x20, reading >> 8 & 15, reading & 255};
    return bytes[at++ - 0x0b];
}

static void come_round(bool ticks) {
#if SENSOR == ENCODER
    hapsim_edges = in_session ? measured[0] : hapsim_edges;
#endif
    hapsim_due = in_session ? now + !ticks : hapsim_due;
    loop();
    const int duty = DRIVER == TWO_PWMS      ? duties[MOTOR_PIN_A] - duties[MOTOR_PIN_B]
                     : levels[MOTOR_PIN_B] ? duties[MOTOR_PIN_A]
                                             : -duties[MOTOR_PIN_A];
    put_out[0] = duty;
}

void knob_init(void) {
    setup();
    come_round(false);
}

void knob_take_byte(uint8_t byte) {
    waiting = byte;
    come_round(false);
}

void knob_tick(void) {
    come_round(true);
}

bool knob_look(void) {
    come_round(false);
    return true;
}

/* Signals of the encoder that change at once run the interrupt of one of them. */
static void turn(int32_t steps) {
    phase += steps;
    levels[SENSOR_PIN_A] = ((phase + 1) >> 1) & 1;
    levels[SENSOR_PIN_B] = (phase >> 1) & 1;
    handlers[phase & 1]();
}

/*   turn STEPS           the encoder turns by as many edges, each with its interrupt
 *   leap                 it turns by two edges, with one interrupt
 *   reading COUNTS       what the converter or the AS5600 gives
 *   silent 0|1           its wire is off
 *   magnet 0|1           it is there
 *   enable               tells the level of the driver's enable pin, as the force
 */
void knob_obey(const char *line) {
    char word[16] = "";
    int value = 0;
    sscanf(line, "%15s %d", word, &value);
    for (int i = 0; strcmp(word, "turn") == 0 && i < abs(value); i++) {
        turn(value < 0 ? -1 : 1);
    }
    if (strcmp(word, "leap") == 0) {
        turn(2);
    } else if (strcmp(word, "reading") == 0) {
        reading = value;
    } else if (strcmp(word, "silent") == 0) {
        silent = value;
    } else if (strcmp(word, "magnet") == 0) {
        no_magnet = !value;
    } else if (strcmp(word, "enable") == 0) {
        put_out[0] = ENABLE_PIN == NO_PIN ? -1 : levels[(ENABLE_PIN + 32) % 32];
    }
}
