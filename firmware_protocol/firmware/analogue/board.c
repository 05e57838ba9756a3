/* SPDX-License-Identifier: MIT */
/* The firmware on an ATmega328P whose sensors give voltages and whose motors are driven by H-bridges. Pins, scales and
 * limits are in the device's header (see hapsim_board.h).
 *
 * The tick of timer 1 starts the converter in hardware, so no interrupt delays a position. PWM comes from timers 0 and
 * 2, at 62.5 kHz. A motor without force has its PWM disconnected and its pin low, because fast PWM at zero would still
 * give pulses of a 256th. */
#include "atmega328p.h"
#include "hapsim_board.h"
#include "hapsim_device.h"
#include "hapsim_port.h"

#include <avr/io.h>

typedef struct {
    volatile uint8_t *compare, *control, *pwm_port, *direction_port;
    uint8_t connect, invert, pwm, direction;
} motor;

#define MOTOR(timer, output, port, bit, to_port, to_bit)                                                              \
    {&OCR##timer##output,                                                                                             \
     &TCCR##timer##A,                                                                                                 \
     &PORT##port,                                                                                                     \
     &PORT##to_port,                                                                                                  \
     _BV(COM##timer##output##1),                                                                                      \
     _BV(COM##timer##output##0),                                                                                      \
     _BV(bit),                                                                                                        \
     _BV(to_bit)}
#define DIRECTIONS(port) (*((port)-1)) /* the register before it */

static const motor motors[HAPSIM_BOARD_CHANNELS] = MOTORS;
static const uint8_t sensors[HAPSIM_BOARD_CHANNELS] = SENSORS;
static int32_t position[HAPSIM_BOARD_CHANNELS];
static int16_t last[HAPSIM_BOARD_CHANNELS];
static uint8_t odd[HAPSIM_BOARD_CHANNELS]; /* bad readings in a row: 2 and more are a fault */
static bool triggered;        /* the timer has started a conversion that is not read yet */

#ifdef TOUCHES
/* Touch pads: a pin that was low charges through a resistor, later where a finger adds its capacitance. Pads charge
 * during the last conversion of a sample, and are low for the rest of it. A touch ends after TOUCH_STAYS samples without
 * one: a finger picks up the mains, too. */
typedef struct {
    volatile uint8_t *direction; /* the register before it is the pins' */
    uint8_t bit;
} pad;
#define TOUCH(port, bit) {&DDR##port, _BV(bit)}

static const pad pads[] = TOUCHES;
enum { PADS = sizeof pads / sizeof *pads };
static uint8_t touched[PADS]; /* samples for which each still counts as touched */

static void charge_pads(void) {
    for (uint8_t i = 0; i < PADS; i++) {
        *pads[i].direction &= (uint8_t)~pads[i].bit;
    }
}

static void read_pads(void) {
    for (uint8_t i = 0; i < PADS; i++) {
        const bool high = *(pads[i].direction - 1) & pads[i].bit;
        touched[i] = !high ? TOUCH_STAYS : touched[i] > 0 ? touched[i] - 1u : 0;
    }
    for (uint8_t i = 0; i < PADS; i++) {
        *pads[i].direction |= pads[i].bit;
    }
}

uint32_t hapsim_port_read_inputs(void) {
    uint8_t inputs = 0;
    for (uint8_t i = 0; i < PADS; i++) {
        inputs |= (uint8_t)((touched[i] > 0) << i);
    }
    return inputs;
}

void hapsim_port_put_outputs(uint32_t outputs) {
    (void)outputs; /* none */
}
#else
#define charge_pads() ((void)0)
#define read_pads() ((void)0)
#endif

static void drive_zero(const motor *one) {
    *one->control &= (uint8_t)~(one->connect | one->invert);
    *one->pwm_port &= (uint8_t)~one->pwm;
    *one->direction_port &= (uint8_t)~one->direction;
}

/* Returns the duty, 0 to 255 of 256, for counts within the limit. */
static uint8_t duty_of(uint16_t counts) {
#if DUTY_IS_ROOT
    uint8_t root = 0;
    for (uint8_t bit = 128; bit; bit >>= 1) {
        const uint16_t tried = root | bit;
        if (tried * tried <= counts) {
            root |= bit;
        }
    }
    return root < 255 && counts - (uint16_t)root * root > root ? root + 1u : root;
#else
    return (uint8_t)counts;
#endif
}

static void drive(const motor *one, int32_t force) {
    const uint8_t duty = duty_of((uint16_t)(force < 0 ? -force : force));
    const bool high = (force > 0) == FORWARD_HIGH;
    if (duty == 0) {
        drive_zero(one);
        return;
    }
    if (high) {
        *one->direction_port |= one->direction;
    } else {
        *one->direction_port &= (uint8_t)~one->direction;
    }
    *one->compare = (uint8_t)(duty - 1);
    *one->control = (uint8_t)((*one->control & ~one->invert) | one->connect | (TWO_INPUTS && high ? one->invert : 0));
}

void hapsim_port_put_forces(const int32_t *counts) {
    for (uint8_t c = 0; c < HAPSIM_BOARD_CHANNELS; c++) {
        drive(&motors[c], counts[c]);
    }
}

static void choose(uint8_t c) {
    ADMUX = (uint8_t)(_BV(REFS0) | sensors[c]); /* reference: the supply, as for the sensors */
}

/* Waits for the conversion that was started. Interrupts stay enabled, as everywhere in the tick. */
static int16_t converted(void) {
    while (ADCSRA & _BV(ADSC)) {
    }
    return (int16_t)ADC;
}

/* Skips a single bad reading. After two in a row, continues from the sensor's present reading. */
static void follow(uint8_t c, int16_t reading) {
    int16_t step = (int16_t)(reading - last[c]);
#ifdef TOOTH
    step = (int16_t)(step > TOOTH / 2 ? step - TOOTH : step < -TOOTH / 2 ? step + TOOTH : step);
#endif
    if (reading < LOWEST || reading > HIGHEST || step > FASTEST || step < -FASTEST) {
        odd[c]++;
        if (odd[c] < 2) {
            return;
        }
        odd[c] = 2;
    } else {
        odd[c] = 0;
#ifdef TOOTH
        position[c] += step;
#else
        position[c] = reading - 1023 * CONVERSIONS / 2;
#endif
    }
    last[c] = reading;
}

static void read_sensors(void) {
    for (uint8_t c = 0; c < HAPSIM_BOARD_CHANNELS; c++) {
        int16_t sum = 0;
        for (uint8_t i = 0; i < CONVERSIONS; i++) {
            const bool last = c + 1 == HAPSIM_BOARD_CHANNELS && i + 1 == CONVERSIONS;
            if (last) {
                charge_pads();
            }
            if (!triggered) {
                ADCSRA |= _BV(ADSC);
            }
            triggered = false;
            sum = (int16_t)(sum + converted());
            if (last) {
                read_pads();
            }
        }
        choose((uint8_t)((c + 1) % HAPSIM_BOARD_CHANNELS));
        follow(c, sum);
    }
}

uint8_t hapsim_port_measure(int32_t *counts, uint8_t parts) {
    bool fault = false;
    (void)parts;
    read_sensors();
    for (uint8_t c = 0; c < HAPSIM_BOARD_CHANNELS; c++) {
        counts[c] = position[c];
        fault |= odd[c] > 1;
    }
    return fault ? HAPSIM_HARDWARE : HAPSIM_NO_FAULT;
}

void board_begin(void) {
}

/* Reads the sensors in every state: an unread tooth of the sawtooth would be lost. */
void board_tick(void) {
    triggered = true;
    hapsim_device_tick();
    if (triggered) {
        read_sensors();
    }
}

void board_start(void) {
    read_pads(); /* low */
    for (uint8_t c = 0; c < HAPSIM_BOARD_CHANNELS; c++) {
        drive_zero(&motors[c]);
        DIRECTIONS(motors[c].pwm_port) |= motors[c].pwm;
        DIRECTIONS(motors[c].direction_port) |= motors[c].direction;
        *motors[c].control |= _BV(WGM01) | _BV(WGM00); /* the same for timers 0 and 2: fast PWM, */
        *(motors[c].control + 1) = _BV(CS00);          /* without a prescaler */
    }
    ADCSRB = _BV(ADTS2) | _BV(ADTS0); /* compare match B of timer 1 */
    ADCSRA = _BV(ADEN) | _BV(ADATE) | PRESCALER;
    choose(0);
    for (uint8_t c = 0; c < HAPSIM_BOARD_CHANNELS; c++) {
        odd[c] = 2;
        last[c] = -16384; /* no sensor's reading: so the first one sets the position, the second one measures a step */
    }
    read_sensors();
    read_sensors();
}
