/* SPDX-License-Identifier: MIT */
/* What every board with an ATmega328P at 16 MHz has: main, the tick, the serial port at HAPSIM_BAUD, the hardware
 * watchdog. A board with one adds these three, hapsim_port_measure and hapsim_port_put_forces. */
#ifndef ATMEGA328P_H
#define ATMEGA328P_H

/* First after a reset, with interrupts off. */
void board_start(void);

/* The host has armed the device, and the timer of the tick has begun anew. */
void board_begin(void);

/* Calls hapsim_device_tick; at every tick of timer 1, in every state. */
void board_tick(void);

#endif
