/* SPDX-License-Identifier: MIT */
/* The common part of boards with an ATmega328P at 16 MHz: main, the tick, the serial port at HAPSIM_BAUD, the hardware
 * watchdog. Each board adds the three functions below, hapsim_port_measure and hapsim_port_put_forces. */
#ifndef ATMEGA328P_H
#define ATMEGA328P_H

#include <stdbool.h>

/* Called first after a reset, with interrupts disabled. */
void board_start(void);

/* Called when the host has armed the device and the tick's timer has restarted. */
void board_begin(void);

/* Called at every tick of timer 1, in every state. Must call hapsim_device_tick. */
void board_tick(void);

/* Of a board that follows lines: called HAPSIM_BOARD_STEPS times as often, and may interrupt board_tick. Must call
 * hapsim_device_step, and returns its result. */
bool board_step(void);

#endif
