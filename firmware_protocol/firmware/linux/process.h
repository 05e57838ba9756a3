/* SPDX-License-Identifier: MIT */
/* A device as a Linux process, on a pseudo-terminal that it makes. One thread: the tick comes between two reads, and
 * needs no lock. This is the part of hapsim_port.h that every such board shares: clock, tick, transmitter. A board adds
 * hapsim_port_measure, _put_forces, _feed_watchdog and _begin.
 *
 * Its clock is made of its ticks: where others held this process up, no tick comes and the clock stands still, so that
 * what ends after a number of periods still ends after that number. */
#ifndef PROCESS_H
#define PROCESS_H

#include <signal.h>
#include <stdint.h>

/* Set by SIGTERM, SIGINT and SIGHUP, or by the board: process_serve returns. */
extern volatile sig_atomic_t process_stopped;

/* Nanoseconds: of the machine, and of the clock that is made of ticks. */
int64_t process_now(void);
int64_t process_clock(void);

/* Makes the pseudo-terminal and prints its path; 0, or 3 with a sentence on standard error. */
int process_open(void);

/* Serves the port until it is stopped; `before_tick` is called ahead of every hapsim_device_tick. */
void process_serve(void (*before_tick)(void));

/* For hapsim_port_begin: the next tick comes one whole period from now. */
void process_restart_period(void);

#endif
