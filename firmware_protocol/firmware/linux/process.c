/* SPDX-License-Identifier: MIT */
#define _GNU_SOURCE
#include "process.h"

#include <hapsim_board.h> /* that of the board being built, not the one beside this file */
#include "hapsim_device.h"
#include "hapsim_port.h"
#include "terminal.h"

#include <poll.h>
#include <stdio.h>
#include <sys/prctl.h>
#include <sys/time.h>
#include <time.h>
#include <unistd.h>

#include "broken.h"

#define SECOND 1000000000ll
#define WATCHDOG_US 250000 /* until its warning */

/* The board's timer makes the ticks, or the local periods of a board that follows lines. */
#ifdef HAPSIM_BOARD_STEPS
#define TIMER_PERIOD ((int64_t)HAPSIM_BOARD_PERIOD_TICKS / HAPSIM_BOARD_STEPS)
#define TICK_IS_DUE() hapsim_device_step()
#else
#define TIMER_PERIOD ((int64_t)HAPSIM_BOARD_PERIOD_TICKS)
#define TICK_IS_DUE() true
#endif

volatile sig_atomic_t process_stopped;

static int port;
static int64_t clock_at_tick, ticked, due; /* the clock at the last tick; the times of the last and the next tick, ns */
static uint8_t unsent[HAPSIM_MAX_FRAME];
static size_t unsent_from, unsent_to;
static void (*release_at_end)(void);
static volatile sig_atomic_t warned;

int64_t process_now(void) {
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return now.tv_sec * SECOND + now.tv_nsec;
}

int64_t process_clock(void) {
    const int64_t since = process_now() - ticked, period = TIMER_PERIOD;
    return clock_at_tick + (since < 0 ? 0 : since < period ? since : period);
}

uint32_t hapsim_port_now(void) {
    return (uint32_t)process_clock();
}

/* Sends the rest of a frame that the terminal took only in part: half a frame is useless. */
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

void process_restart_period(void) {
    clock_at_tick = process_clock();
    ticked = process_now();
    due = ticked + BROKEN_PERIOD(TIMER_PERIOD);
}

void hapsim_port_hold_tick(void) {}
void hapsim_port_let_tick(void) {}

static void read_bytes(int64_t until) {
    uint8_t bytes[256];
    struct pollfd ready = {port, POLLIN, 0};
    const int64_t left = until - process_now();
    const struct timespec wait = {0, left > 0 ? left % SECOND : 0};
    if (ppoll(&ready, 1, &wait, NULL) <= 0) {
        return;
    }
    const ssize_t count = read(port, bytes, sizeof bytes);
    for (ssize_t i = 0; i < count; i++) {
        hapsim_device_take_byte(bytes[i]);
    }
}

static void tick_when_due(void (*before_tick)(void)) {
    const int64_t period = BROKEN_PERIOD(TIMER_PERIOD);
    if (process_now() < due || BROKEN_TICK()) {
        return;
    }
    clock_at_tick += TIMER_PERIOD;
    ticked = process_now();
    due += period;
    before_tick();
    if (TICK_IS_DUE()) {
        hapsim_device_tick();
    }
    /* This machine was late, as a device's timer never is: no burst of ticks. Local periods are made up for. */
    if (process_now() >= due + (int64_t)HAPSIM_BOARD_PERIOD_TICKS - TIMER_PERIOD) {
        due = process_now() + period;
    }
}

static void stop(int number) {
    (void)number;
    process_stopped = 1;
}

static void on_alarm(int number) {
    (void)number;
    if (!warned) {
        warned = 1;
        return;
    }
    if (release_at_end != NULL) {
        release_at_end();
    }
    _exit(1);
}

void process_begin_watchdog(void (*release)(void)) {
    release_at_end = release;
    signal(SIGALRM, on_alarm);
}

void process_feed_watchdog(void) {
    const struct itimerval interval = {{0, WATCHDOG_US}, {0, WATCHDOG_US}};
    warned = 0;
    setitimer(ITIMER_REAL, &interval, NULL);
}

int process_open(void) {
    char path[64];
    port = open_terminal(path, sizeof path);
    if (port < 0) {
        fprintf(stderr, "no pseudo-terminal is to be had\n");
        return 3;
    }
    signal(SIGTERM, stop);
    signal(SIGINT, stop);
    signal(SIGHUP, stop);
    printf("%s\n", path);
    fflush(stdout);
    return 0;
}

void process_serve(void (*before_tick)(void)) {
    prctl(PR_SET_TIMERSLACK, 1);
    due = ticked = process_now();
    while (!process_stopped) {
        /* When the host paces, the main loop runs more often than the tick. */
        const int64_t soon = process_now() + HAPSIM_BOARD_PERIOD_TICKS / 10;
        read_bytes(hapsim_device_look() && soon < due ? soon : due);
        tick_when_due(before_tick);
    }
}
