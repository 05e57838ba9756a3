/* SPDX-License-Identifier: MIT */
/* Cycles of the firmware's interrupts and main loop, measured from outside of the chip. */
#ifndef CYCLES_H
#define CYCLES_H

#include <sim_avr.h>
#include <stdio.h>

void watch_cycles(avr_t *avr);
void tell_cycles(FILE *to);

#endif
