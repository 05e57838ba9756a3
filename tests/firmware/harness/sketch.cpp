/* The harness with the Arduino sketch for its board: what the harness calls of the state machine goes through loop() and
 * the port. */
extern "C" {
#include "hapsim_device.h"
}
#undef HAPSIM_F64
#define HAPSIM_F64(high, low) {low, high} /* of the harness's constants, in C++ */
#include <motor.ino>

#include "given_serial.h"
#include "uno_pins.h"

#include <stdio.h>

static int32_t reading = COUNTS / 2, phase;
static bool silent, no_magnet;
static const bool in_session = HAPSIM_FORCE_COUNTS == 1; /* which says when a tick comes, and places the encoder */

unsigned long micros() {
    return now;
}

int analogRead(uint8_t) {
    return silent ? 0 : reading;
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
    put_out[0] = drive();
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
