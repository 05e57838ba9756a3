/* SPDX-License-Identifier: MIT */
/* The port layer: what the state machine (hapsim_device.c) asks of a board. A maker writes these functions, and the
 * constants in the board's own hapsim_board.h; nothing else has to change.
 *
 * Two contexts call them. The *tick*: the sample timer's interrupt, which calls hapsim_device_tick. The *bytes*: the
 * main loop (or a task), which hands over what the receiver collected. Only the tick may interrupt the bytes.
 */
#ifndef HAPSIM_PORT_H
#define HAPSIM_PORT_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

/* A free-running clock, HAPSIM_BOARD_PERIOD_TICKS of it in a sample period; it wraps at 32 bits. */
uint32_t hapsim_port_now(void);

/* The positions of all channels in counts, now; behind them the velocities where `velocity` is set. HAPSIM_NO_FAULT, or
 * HAPSIM_POSITION_OUT_OF_RANGE where a position does not fit 32 bits, or HAPSIM_HARDWARE. A velocity that does not fit
 * stops at the end of its counts. The device's zero is where it powered up or homed: nothing here moves it. */
uint8_t hapsim_port_measure(int32_t *counts, bool velocity);

/* Puts out the forces of all channels, in counts, until the next call. They are within the limits already. A positive
 * force accelerates towards larger positions. After a reset the outputs must be at zero before this is ever called. */
void hapsim_port_put_forces(const int32_t *counts);

/* Hands a whole frame to the transmitter. MUST NOT WAIT: false, and not one byte of it sent, where there is no room.
 * The next sample carries newer data than this frame would by then, and a tick that waits for a host that does not read
 * is a force that nothing watches. */
bool hapsim_port_write(const uint8_t *bytes, size_t count);

/* Puts off the hardware watchdog's reset. It is called from the tick and from nowhere else, so that a tick that died
 * ends in a reset, and a reset in zero force. Leave it some 10 to 60 sample periods. */
void hapsim_port_feed_watchdog(void);

/* The host has armed the device: the next tick comes one whole sample period from now. */
void hapsim_port_begin(void);

/* Keeps the tick from interrupting, and lets it again. The receiver's interrupt goes on: bytes come at any time.
 * Both have to be functions of another file (or hold a memory barrier), so that the compiler moves nothing across them. */
void hapsim_port_hold_tick(void);
void hapsim_port_let_tick(void);

#endif
