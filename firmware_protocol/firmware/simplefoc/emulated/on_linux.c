/* SPDX-License-Identifier: MIT */
/* hardware.h as a Linux process on a pseudo-terminal that the process makes: `simplefoc [LOG]` prints the port's path.
 * There is one thread: on_systick, once in SLICE_US, comes when the main loop rests, and the clock follows it.
 * `simplefoc LOG lockstep=1` gives virtual time (lockstep.h): the clock stops after each position until the host has
 * answered, and then runs as fast as it can. */
#define _GNU_SOURCE
#include "hardware.h"
#include "lockstep.h"
#include "terminal.h"

#include <fcntl.h>
#include <poll.h>
#include <stdbool.h>
#include <stdio.h>
#include <string.h>
#include <sys/prctl.h>
#include <time.h>
#include <unistd.h>

#ifndef SLICE_US
#define SLICE_US 1000
#endif
#define SLICE (SLICE_US * 1000ll)
#define MOST_BEHIND 1000000ll /* ns */
#define GIVES_UP_MS 10000     /* longest wait for an answer in lockstep */
#define HURRIES 1000          /* slices after a position in lockstep: more than a sample has */

int run_board(void);
void on_systick(void);

static int port, log_file = -1;
static int64_t due;
static uint32_t ticks;
static uint8_t unsent[RING];
static size_t unsent_from, unsent_to;
static uint8_t received[RING];
static size_t received_from, received_to;
static bool lockstep, asked;
static int hurries; /* slices that wait for no clock */

static int64_t now_ns(void) {
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return now.tv_sec * 1000000000ll + now.tv_nsec;
}

void start_hardware(void) {
    due = now_ns() + SLICE;
}

void begin_period(void) {
    due = now_ns() + SLICE;
}

uint32_t now_us(void) {
    const int64_t left = (due - now_ns()) / 1000;
    return ticks * SLICE_US + (uint32_t)(left < 0 ? SLICE_US : left > SLICE_US ? 0 : SLICE_US - left);
}

int bytes_to_read(void) {
    if (received_from == received_to) {
        const ssize_t count = read(port, received, sizeof received);
        received_from = 0;
        received_to = count > 0 ? (size_t)count : 0;
        asked = asked && received_to == 0;
        if (lockstep) {
            take_lockstep(received, received_to);
        }
    }
    return (int)(received_to - received_from);
}

int next_byte(void) {
    return bytes_to_read() > 0 ? received[received_from++] : NOTHING_CAME;
}

/* Sends the rest of a frame that the terminal took only in part: half a frame is useless. */
size_t room_to_send(void) {
    while (unsent_from < unsent_to) {
        const ssize_t sent = write(port, unsent + unsent_from, unsent_to - unsent_from);
        if (sent <= 0) {
            return 0;
        }
        unsent_from += (size_t)sent;
    }
    return RING;
}

void send_bytes(const uint8_t *bytes, size_t count) {
    memcpy(unsent, bytes, count);
    unsent_from = 0;
    unsent_to = count;
    if (lockstep && offer_lockstep(unsent, count)) {
        asked = true;
        hurries = HURRIES;
    }
    (void)room_to_send();
}

/* Returns whether a byte has come before the slice ended. */
static bool wait_for_byte(void) {
    struct pollfd ready = {port, POLLIN, 0};
    if (asked) {
        asked = false;
        return poll(&ready, 1, GIVES_UP_MS) > 0;
    }
    if (hurries > 0) {
        hurries--;
        due = now_ns();
    }
    const int64_t left = due - now_ns();
    const struct timespec wait = {0, left > 0 ? left : 0};
    return ppoll(&ready, 1, &wait, NULL) > 0 || now_ns() < due;
}

void rest(void) {
    if (received_from < received_to || wait_for_byte()) {
        return;
    }
    ticks++;
    due += SLICE;
    on_systick();
    if (now_ns() >= due + MOST_BEHIND - SLICE) { /* this machine was late, as a device's timer never is: no burst */
        due = now_ns() + SLICE;
    }
}

void feed_watchdog(void) {}

void note_force(uint32_t us, int32_t counts) {
    if (log_file >= 0) {
        dprintf(log_file, "%08lx %08lx\n", (unsigned long)us, (unsigned long)(uint32_t)counts);
    }
}

int main(int count, char **words) {
    char path[64];
    port = open_terminal(path, sizeof path);
    if (port < 0) {
        fprintf(stderr, "no pseudo-terminal is to be had\n");
        return 3;
    }
    log_file = count > 1 ? open(words[1], O_WRONLY | O_CREAT | O_TRUNC, 0666) : -1;
    lockstep = count > 2 && strcmp(words[2], "lockstep=1") == 0;
    prctl(PR_SET_TIMERSLACK, 1);
    printf("%s\n", path);
    fflush(stdout);
    return run_board();
}
