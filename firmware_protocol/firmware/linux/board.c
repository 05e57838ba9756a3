/* SPDX-License-Identifier: MIT */
/* The firmware as a Linux process, on a pseudo-terminal that it makes: `linux [LOG]` prints the port's path and serves it
 * until it is stopped. One thread: the tick comes between two reads, and needs no lock.
 *
 * Its clock is made of its ticks: where others held this process up, no tick comes and the clock stands still, so that
 * what ends after a number of periods still ends after that number.
 *
 * LOG: each force put out, be it the same again, a line of two hexadecimal words: microseconds of that clock, and counts.
 */
#define _GNU_SOURCE
#include "hapsim_board.h"
#include "hapsim_device.h"
#include "hapsim_port.h"
#include "simulated_mass.h"
#include "terminal.h"

#include <fcntl.h>
#include <poll.h>
#include <signal.h>
#include <stdio.h>
#include <sys/prctl.h>
#include <sys/time.h>
#include <time.h>
#include <unistd.h>

#include "broken.h"

#define SECOND 1000000000ll
#define WATCHDOG_US 250000 /* to its first warning; as long again to the end */

static int port, log_file = -1;
static int64_t clock_at_tick, ticked, due; /* what the clock said at the last tick; when that was, and when the next is */
static simulated_mass mass;
static int32_t force;
static uint8_t unsent[HAPSIM_MAX_FRAME];
static size_t unsent_from, unsent_to;
static volatile sig_atomic_t stopped, warned;

static int64_t now_ns(void) {
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return now.tv_sec * SECOND + now.tv_nsec;
}

static int64_t clock_ns(void) {
    const int64_t since = now_ns() - ticked, period = HAPSIM_BOARD_PERIOD_TICKS;
    return clock_at_tick + (since < 0 ? 0 : since < period ? since : period);
}

uint32_t hapsim_port_now(void) {
    return (uint32_t)clock_ns();
}

uint8_t hapsim_port_measure(int32_t *counts, bool velocity) {
    const bool fits = simulated_mass_position(&mass, &counts[0]);
    counts[0] = BROKEN_POSITION(counts[0]);
    if (velocity) {
        counts[1] = simulated_mass_velocity(&mass);
    }
    return fits ? HAPSIM_NO_FAULT : HAPSIM_POSITION_OUT_OF_RANGE;
}

static void note_force(int32_t counts) {
    char line[32];
    const uint32_t us = (uint32_t)(clock_ns() / 1000);
    const int length = snprintf(line, sizeof line, "%08lx %08lx\n", (unsigned long)us, (unsigned long)(uint32_t)counts);
    if (log_file >= 0 && write(log_file, line, (size_t)length) != length) {
        log_file = -1;
    }
}

void hapsim_port_put_forces(const int32_t *counts) {
    force = BROKEN_FORCE(counts[0]);
    note_force(force);
}

/* What a terminal took in part goes first: half a frame is none. */
static bool send_unsent(void) {
    while (unsent_from < unsent_to) {
        const ssize_t sent = write(port, unsent + unsent_from, unsent_to - unsent_from);
        if (sent <= 0) {
            return false;
        }
        unsent_from += (size_t)sent;
    }
    return true;
}

bool hapsim_port_write(const uint8_t *bytes, size_t count) {
    while (!send_unsent()) {
        if (!BROKEN_WAIT(port)) {
            return false;
        }
    }
    memcpy(unsent, bytes, count);
    unsent_from = 0;
    unsent_to = count;
    (void)send_unsent();
    return true;
}

/* A process has no reset but its end, with the force at zero. Where others share the machine it may be held up for long:
 * then the first alarm is there before its next tick, and so it only warns. */
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
    clock_at_tick = clock_ns();
    ticked = now_ns();
    due = ticked + BROKEN_PERIOD((int64_t)HAPSIM_BOARD_PERIOD_TICKS);
    simulated_mass_flick(&mass);
}

void hapsim_port_hold_tick(void) {}
void hapsim_port_let_tick(void) {}

static void read_bytes(int64_t until) {
    uint8_t bytes[256];
    struct pollfd ready = {port, POLLIN, 0};
    const int64_t left = until - now_ns();
    const struct timespec wait = {0, left > 0 ? left % SECOND : 0};
    if (ppoll(&ready, 1, &wait, NULL) <= 0) {
        return;
    }
    const ssize_t count = read(port, bytes, sizeof bytes);
    for (ssize_t i = 0; i < count; i++) {
        hapsim_device_take_byte(bytes[i]);
    }
}

static void tick_when_due(void) {
    const int64_t period = BROKEN_PERIOD((int64_t)HAPSIM_BOARD_PERIOD_TICKS);
    if (now_ns() < due || BROKEN_TICK()) {
        return;
    }
    clock_at_tick += HAPSIM_BOARD_PERIOD_TICKS;
    ticked = now_ns();
    due += period;
    simulated_mass_move(&mass, force);
    hapsim_device_tick();
    if (now_ns() >= due) { /* a device's timer is never late, but this machine was: no burst of ticks */
        due = now_ns() + period;
    }
}

static void stop(int number) {
    (void)number;
    stopped = 1;
}

int main(int count, char **words) {
    char path[64];
    port = open_terminal(path, sizeof path);
    if (port < 0) {
        fprintf(stderr, "no pseudo-terminal is to be had\n");
        return 3;
    }
    if (count > 1) {
        log_file = open(words[1], O_WRONLY | O_CREAT | O_TRUNC, 0666);
    }
    signal(SIGALRM, on_alarm);
    signal(SIGTERM, stop);
    signal(SIGINT, stop);
    prctl(PR_SET_TIMERSLACK, 1);
    due = ticked = now_ns();
    hapsim_device_init();
    printf("%s\n", path);
    fflush(stdout);
    while (!stopped) {
        /* Paced by the host, the main loop comes round more often than the tick. */
        const int64_t soon = now_ns() + HAPSIM_BOARD_PERIOD_TICKS / 10;
        read_bytes(hapsim_device_look() && soon < due ? soon : due);
        tick_when_due();
    }
    note_force(0);
    return 0;
}
