/* SPDX-License-Identifier: MIT */
/* A device as a Linux process, on a pseudo-terminal that the process makes. There is one thread: the tick comes between
 * two reads and needs no lock. This file has the part of hapsim_port.h that all such boards share: clock, tick,
 * transmitter. A board adds hapsim_port_measure, _put_forces, _feed_watchdog and _begin.
 *
 * The clock follows the ticks. When other programs hold this process up, no tick comes and the clock stands still. So a
 * timeout of some periods still ends after that number of ticks. */
#ifndef PROCESS_H
#define PROCESS_H

#include <signal.h>
#include <stdint.h>

/* SIGTERM, SIGINT, SIGHUP or the board set this; then process_serve returns. */
extern volatile sig_atomic_t process_stopped;

/* Return nanoseconds: of the machine's clock, and of the clock that follows the ticks. */
int64_t process_now(void);
int64_t process_clock(void);

/* Makes the pseudo-terminal and prints its path. Returns 0, or 3 with a message on standard error. */
int process_open(void);

/* Serves the port until process_stopped is set. Calls `before_tick` before every hapsim_device_tick, or before every
 * hapsim_device_step of a board that follows lines. */
void process_serve(void (*before_tick)(void));

/* Begins a hardware watchdog, whose reset is the end of this process, after `release` (NULL: nothing). On a shared
 * machine, other programs may hold the process up for long. Then the first alarm may come before the next tick, so it
 * only warns: the end follows after as long again. */
void process_begin_watchdog(void (*release)(void));
void process_feed_watchdog(void);

/* Restarts the period, for hapsim_port_begin: the next tick comes one whole period from now. */
void process_restart_period(void);

#endif
