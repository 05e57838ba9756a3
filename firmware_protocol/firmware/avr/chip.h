/* SPDX-License-Identifier: MIT */
/* Features of the ATmega328P that simavr 1.6 lacks: the time of a byte on the wire, a receiver that keeps only two
 * bytes, and the cycles to enter an interrupt. */
#ifndef CHIP_H
#define CHIP_H

#include <sim_avr.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>

/* Adds these features. Call it after avr_init. */
void mend_chip(avr_t *avr);

/* Returns the number of bytes that the wire to the chip takes now. */
size_t wire_room(void);

/* Puts `count` bytes on the wire, at most wire_room(). Each arrives when its time on the wire is over. */
void put_on_wire(const uint8_t *bytes, size_t count);

/* Prints how many bytes arrived, and how many were lost because the firmware was too slow. */
void tell_wire(FILE *to);

#endif
