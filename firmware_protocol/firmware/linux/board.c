/* SPDX-License-Identifier: MIT */
/* The firmware as a Linux process that moves a simulated mass: `linux [LOG]` prints its port's path and serves the port
 * until it is stopped.
 *
 * LOG gets a line for each force put out, even for the same force again. The line has two hexadecimal words:
 * microseconds of the process's clock, and counts.
 */
#define _GNU_SOURCE
#include "hapsim_board.h"
#include "hapsim_device.h"
#include "hapsim_port.h"
#include "process.h"
#include "simulated_mass.h"

#include <fcntl.h>
#include <stdio.h>
#include <sys/time.h>
#include <unistd.h>

#include "broken.h"

#define WATCHDOG_US 250000 /* until its warning; the end follows after as long again */

static int log_file = -1;
static simulated_mass mass;
static int32_t force;
static volatile sig_atomic_t warned;

uint8_t hapsim_port_measure(int32_t *counts, uint8_t parts) {
    const bool fits = simulated_mass_position(&mass, &counts[0]);
    counts[0] = BROKEN_POSITION(counts[0]);
    int32_t *next = counts + 1;
    if (parts & HAPSIM_WITH_VELOCITY) {
        *next++ = simulated_mass_velocity(&mass);
    }
    if (parts & HAPSIM_WITH_ACCELERATION) {
        *next = BROKEN_ACCELERATION(simulated_mass_acceleration(&mass, force));
    }
    return fits ? HAPSIM_NO_FAULT : HAPSIM_POSITION_OUT_OF_RANGE;
}

static void note_force(int32_t counts) {
    char line[32];
    const uint32_t us = (uint32_t)(process_clock() / 1000);
    const int length = snprintf(line, sizeof line, "%08lx %08lx\n", (unsigned long)us, (unsigned long)(uint32_t)counts);
    if (log_file >= 0 && write(log_file, line, (size_t)length) != length) {
        log_file = -1;
    }
}

void hapsim_port_put_forces(const int32_t *counts) {
    force = BROKEN_FORCE(counts[0]);
    note_force(force);
}

/* The reset of a process is its end, with the force at zero. On a shared machine, other programs may hold the process
 * up for long. Then the first alarm may come before the next tick, so this alarm only warns. */
static void on_alarm(int number) {
    (void)number;
    if (!warned) {
        warned = 1;
        return;
    }
    note_force(0);
    _exit(1);
}

void hapsim_port_feed_watchdog(void) {
    const struct itimerval interval = {{0, WATCHDOG_US}, {0, WATCHDOG_US}};
    warned = 0;
    setitimer(ITIMER_REAL, &interval, NULL);
}

void hapsim_port_begin(void) {
    process_restart_period();
    simulated_mass_flick(&mass);
}

static void move_mass(void) {
    simulated_mass_move(&mass, force);
}

int main(int count, char **words) {
    if (count > 1) {
        log_file = open(words[1], O_WRONLY | O_CREAT | O_TRUNC, 0666);
    }
    signal(SIGALRM, on_alarm);
    hapsim_device_init();
    const int status = process_open();
    if (status != 0) {
        return status;
    }
    process_serve(move_mass);
    note_force(0);
    return 0;
}
