/* SPDX-License-Identifier: MIT */
/* The MPS2 board for its two firmwares: UART, SysTick, a clock, the watchdog, and a log of the forces. Each firmware
 * defines on_systick, the tick; hardware.c defines the other interrupts. */
#ifndef HARDWARE_H
#define HARDWARE_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

enum { RING = 256, NOTHING_CAME = -1, BYTES_WERE_LOST = -2 }; /* RING: a power of two, above the longest frame */

/* Starts the hardware: SysTick comes once a millisecond from now on, or SIMULATED_STEPS times. */
void start_hardware(void);

/* Returns the microseconds of a free-running clock. */
uint32_t now_us(void);

/* Restarts the period: the next tick comes a whole period from now. */
void begin_period(void);

/* TIMER_PRIORITY disables the interrupts of SysTick and of the tick, but not the receiver's; 0 enables them again. */
enum { TIMER_PRIORITY = 0x60, TICK_PRIORITY = 0x80 };
void keep_out(uint32_t priority);

/* Runs on_pendsv, with TICK_PRIORITY, once SysTick's handler has returned. */
void call_for_tick(void);

/* Returns the number of received bytes that are not read yet. */
int bytes_to_read(void);

/* Returns a byte of the host, or NOTHING_CAME. If the ring ran over, returns BYTES_WERE_LOST before the next byte. */
int next_byte(void);

/* Returns the number of bytes that send_bytes takes. Call send_bytes from the tick, or while the tick is held off. */
size_t room_to_send(void);
void send_bytes(const uint8_t *bytes, size_t count);

/* Lets a second timer wake the main loop twice in a period, or not. */
void wake_often(bool often);

/* Sleeps until the next interrupt, unless a byte has come since the last check. */
void rest(void);

void feed_watchdog(void);

/* Writes a line of the log: microseconds and counts. It uses semihosting, which stops a real chip without a debugger; a
 * real board must omit it. */
void note_force(uint32_t us, int32_t counts);

#endif
