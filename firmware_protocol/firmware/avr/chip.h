/* SPDX-License-Identifier: MIT */
/* What the ATmega328P does and simavr 1.6 does not: the time that a byte takes on the wire, a receiver that keeps two
 * bytes and no more, and the cycles that it takes to enter an interrupt. */
#ifndef CHIP_H
#define CHIP_H

#include <sim_avr.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>

/* After avr_init. */
void mend_chip(avr_t *avr);

/* How many bytes the wire to the chip takes now. */
size_t wire_room(void);

/* Puts `count` bytes on the wire, at most wire_room(): they arrive one after another, each when its time is over. */
void put_on_wire(const uint8_t *bytes, size_t count);

/* What arrived, and what came too soon for the firmware. */
void tell_wire(FILE *to);

#endif
