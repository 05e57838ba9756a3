/* SPDX-License-Identifier: MIT */
/* The MPS2 board as its two firmwares use it: UART, SysTick, a clock, the watchdog, and a log of the forces. A firmware
 * has on_systick, the tick; the rest of the interrupts is here. */
#ifndef HARDWARE_H
#define HARDWARE_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

enum { RING = 256, NOTHING_CAME = -1, BYTES_WERE_LOST = -2 }; /* RING: a power of two, above the longest frame */

/* SysTick comes once a millisecond from now on. */
void start_hardware(void);

/* Of a clock that runs free. */
uint32_t now_us(void);

/* The next tick comes a whole period from now. */
void begin_period(void);

/* Keeps the tick from interrupting, not the receiver; 0 lets it again. */
enum { TICK_PRIORITY = 0x80 };
void keep_out(uint32_t priority);

/* Bytes of the host that wait. */
int bytes_to_read(void);

/* A byte of the host; NOTHING_CAME; or BYTES_WERE_LOST before the next one, as the ring ran over. */
int next_byte(void);

/* Bytes that send_bytes takes at once. It is called by the tick, or while the tick is held off. */
size_t room_to_send(void);
void send_bytes(const uint8_t *bytes, size_t count);

/* Whether a second timer wakes the main loop twice in a period. */
void wake_often(bool often);

/* Sleeps until the next interrupt, unless a byte came after it was looked for. */
void rest(void);

void feed_watchdog(void);

/* A line of the log: microseconds and counts. By semihosting: a real chip without a debugger stops at it, so a real
 * board leaves it out. */
void note_force(uint32_t us, int32_t counts);

#endif
