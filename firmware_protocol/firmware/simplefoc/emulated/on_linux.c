/* SPDX-License-Identifier: MIT */
/* hardware.h as a Linux process on a pseudo-terminal that the process makes: `simplefoc [LOG]` prints the port's path.
 * There is one thread: the tick comes when the main loop rests, and the clock follows the ticks. */
#define _GNU_SOURCE
#include "hardware.h"
#include "terminal.h"

#include <fcntl.h>
#include <poll.h>
#include <stdio.h>
#include <string.h>
#include <sys/ioctl.h>
#include <sys/prctl.h>
#include <time.h>
#include <unistd.h>

#define MS 1000000ll

int run_board(void);
void on_systick(void);

static int port, log_file = -1;
static int64_t due;
static uint32_t ticks;
static uint8_t unsent[RING];
static size_t unsent_from, unsent_to;

static int64_t now_ns(void) {
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return now.tv_sec * 1000 * MS + now.tv_nsec;
}

void start_hardware(void) {
    due = now_ns() + MS;
}

void begin_period(void) {
    due = now_ns() + MS;
}

uint32_t now_us(void) {
    const int64_t left = (due - now_ns()) / 1000;
    return ticks * 1000 + (uint32_t)(left < 0 ? 1000 : left > 1000 ? 0 : 1000 - left);
}

int bytes_to_read(void) {
    int count = 0;
    return ioctl(port, FIONREAD, &count) == 0 ? count : 0;
}

int next_byte(void) {
    uint8_t byte;
    return read(port, &byte, 1) == 1 ? byte : NOTHING_CAME;
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
    (void)room_to_send();
}

void rest(void) {
    struct pollfd ready = {port, POLLIN, 0};
    const int64_t left = due - now_ns();
    const struct timespec wait = {0, left > 0 ? left : 0};
    if (ppoll(&ready, 1, &wait, NULL) > 0 || now_ns() < due) {
        return;
    }
    ticks++;
    due += MS;
    on_systick();
    if (now_ns() >= due) { /* this machine was late, as a device's timer never is: no burst of ticks */
        due = now_ns() + MS;
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
    prctl(PR_SET_TIMERSLACK, 1);
    printf("%s\n", path);
    fflush(stdout);
    return run_board();
}
