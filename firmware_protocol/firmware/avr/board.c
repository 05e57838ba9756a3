/* SPDX-License-Identifier: MIT */
/* The firmware on an ATmega328P at 2 Mbaud and 1 kHz. In place of an encoder there is simulated_mass.c. In place of a
 * motor driver there is a converter on two registers. GPIOR0 takes four bytes of force, the lowest first; a write to
 * GPIOR1 puts them out. */
#include "atmega328p.h"
#include "hapsim_board.h"
#include "hapsim_device.h"
#include "hapsim_port.h"
#include "simulated_mass.h"

#include <avr/io.h>

static simulated_mass mass;
static int32_t force;

void board_start(void) {
#if HAPSIM_BOARD_DIGITAL_WORD
    DDRB |= 0x3F;
#endif
}

#if HAPSIM_BOARD_DIGITAL_WORD
uint32_t hapsim_port_read_inputs(void) {
    return (uint16_t)((PINC & 0x3Fu) << 8 | (PINB & 0x3Fu));
}

void hapsim_port_put_outputs(uint32_t outputs) {
    PORTB = (uint8_t)(outputs & 0x3Fu);
}
#endif

void board_begin(void) {
    simulated_mass_flick(&mass);
}

#ifdef HAPSIM_BOARD_STEPS
bool board_step(void) {
    simulated_mass_move(&mass, force);
    return hapsim_device_step();
}

void board_tick(void) {
    hapsim_device_tick();
}
#else
void board_tick(void) {
    simulated_mass_move(&mass, force);
    hapsim_device_tick();
}
#endif

uint8_t hapsim_port_measure(int32_t *counts, uint8_t parts) {
    const bool fits = simulated_mass_position(&mass, &counts[0]);
    if (parts & HAPSIM_WITH_VELOCITY) {
        counts[1] = simulated_mass_velocity(&mass);
    }
    return fits ? HAPSIM_NO_FAULT : HAPSIM_POSITION_OUT_OF_RANGE;
}

void hapsim_port_put_forces(const int32_t *counts) {
    force = counts[0];
    uint32_t word = (uint32_t)force;
    for (uint8_t byte = 0; byte < 4; byte++, word >>= 8) {
        GPIOR0 = (uint8_t)word;
    }
    GPIOR1 = 1;
}
