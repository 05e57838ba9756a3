/* SPDX-License-Identifier: MIT */
/* Runs the AVR firmware on simavr: `run_avr FIRMWARE.hex [LOG [NAME=NUMBER ...]]` connects UART 0 to a pseudo-terminal
 * and prints its path. It runs until it is stopped. At the end it prints how many cycles the firmware's parts took.
 *
 * The emulated clock follows real time and never runs ahead of it. If this machine was held up for longer than a
 * sample, that time is lost: a burst of samples would be of no use.
 *
 * NAME=NUMBER sets a property of analogue/plant.c, which simulates an analogue board's motors and sensors. `lockstep=1`
 * gives virtual time, for a scene with `clock: lockstep` (lockstep.h). The emulated clock then stops after each
 * position until the host has answered, and otherwise runs as fast as it can.
 *
 * LOG gets a line for each force put out, even for the same force again. The line has two hexadecimal words:
 * microseconds of the emulated clock, and counts. An analogue board logs each change of the duty, in 256ths.
 */
#define _GNU_SOURCE
#include "chip.h"
#include "cycles.h"
#include "lockstep.h"
#ifdef HAPSIM_ANALOGUE
#include "plant.h"
#endif
#include "terminal.h"

#include <avr_uart.h>
#include <fcntl.h>
#include <poll.h>
#include <signal.h>
#include <stdbool.h>
#include <sim_avr.h>
#include <sim_hex.h>
#include <sim_io.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/prctl.h>
#include <time.h>
#include <unistd.h>

#define CHIP "atmega328p"
#define CYCLES_PER_US 16u
#define SLICE_US 100
#define BYTES_PER_SLICE 32 /* more than arrive in a slice at 2 Mbaud, so the wire never runs empty */
#define MOST_BEHIND_US 1000
#define GIVES_UP_MS 10000 /* longest wait for an answer in lockstep */
#define GPIOR0 0x3e
#define GPIOR1 0x4a

static avr_t *avr;
static int port, log_file = -1, lockstep;
static uint8_t unsent[4096];
static size_t unsent_bytes;
static void (*reset_chip)(avr_t *);
static volatile sig_atomic_t stopped;

static void stop(int number) {
    (void)number;
    stopped = 1;
}

static void note_force(uint64_t cycle, int32_t counts) {
    char line[32];
    const int length = snprintf(line, sizeof line, "%08lx %08lx\n", (unsigned long)(uint32_t)(cycle / CYCLES_PER_US),
                                (unsigned long)(uint32_t)counts);
    if (log_file >= 0 && write(log_file, line, (size_t)length) != length) {
        log_file = -1;
    }
}

#ifndef HAPSIM_ANALOGUE
static uint32_t shifted;

static void on_gpior0(avr_t *chip, avr_io_addr_t address, uint8_t value, void *unused) {
    (void)unused;
    chip->data[address] = value;
    shifted = shifted >> 8 | (uint32_t)value << 24;
}

static void on_gpior1(avr_t *chip, avr_io_addr_t address, uint8_t value, void *unused) {
    (void)unused;
    chip->data[address] = value;
    note_force(chip->cycle, (int32_t)shifted);
}

static bool set_plant(const char *word) {
    return !word;
}

static void connect_plant(avr_t *chip, void (*note)(uint64_t, int32_t)) {
    (void)note;
    avr_register_io_write(chip, GPIOR0, on_gpior0, NULL);
    avr_register_io_write(chip, GPIOR1, on_gpior1, NULL);
}

/* The converter has a reset pin, which the chip's reset pulls. */
static void reset_plant(void) {
    shifted = 0;
    note_force(avr->cycle, 0);
}

static void tell_plant(void) {
}
#endif

static void on_reset(avr_t *chip) {
    reset_plant();
    if (reset_chip) {
        reset_chip(chip);
    }
}

static void on_byte(avr_irq_t *irq, uint32_t byte, void *unused) {
    (void)irq, (void)unused;
    if (unsent_bytes < sizeof unsent) {
        unsent[unsent_bytes++] = (uint8_t)byte;
    }
}

/* Writes the frame at `at`. Returns the bytes written; a frame without room in the terminal counts as written and is
 * lost whole, unless part of it was sent before. */
static size_t send_frame(size_t at, size_t length, bool *begun) {
    const ssize_t sent = write(port, unsent + at, length);
    if (sent == (ssize_t)length || (sent <= 0 && !*begun)) {
        *begun = false;
        return length;
    }
    *begun = true;
    return sent > 0 ? (size_t)sent : 0;
}

/* Sends the whole frames; returns whether there was a position. A host that does not read loses whole frames here,
 * never pieces of them. */
static bool send_bytes(void) {
    static bool begun;
    bool position = false;
    size_t at = 0, kept = 0;
    const uint8_t *end;
    while ((end = memchr(unsent + at, 0, unsent_bytes - at)) != NULL) {
        const size_t length = (size_t)(end - unsent) + 1 - at;
        position |= lockstep && offer_lockstep(unsent + at, length);
        if (kept == 0) {
            const size_t sent = send_frame(at, length, &begun);
            kept = length - sent; /* the rest is sent first the next time; whole frames after it are dropped */
            memmove(unsent, unsent + at + sent, kept);
        }
        at += length;
    }
    unsent_bytes -= at;
    memmove(unsent + kept, unsent + at, unsent_bytes);
    unsent_bytes += kept;
    return position;
}

static void receive_bytes(void) {
    uint8_t bytes[BYTES_PER_SLICE];
    const size_t room = wire_room();
    const ssize_t count = read(port, bytes, room < sizeof bytes ? room : sizeof bytes);
    if (lockstep && count > 0) {
        take_lockstep(bytes, (size_t)count);
    }
    put_on_wire(bytes, count > 0 ? (size_t)count : 0);
}

/* A sleeping chip jumps to its next timer at once; run() keeps real time. */
static void sleep_for(avr_t *chip, avr_cycle_count_t cycles) {
    (void)chip, (void)cycles;
}

/* A timer that keeps a sleeping chip from running beyond the slice. */
static avr_cycle_count_t end_of_slice(avr_t *chip, avr_cycle_count_t when, void *unused) {
    (void)chip, (void)when, (void)unused;
    return 0;
}

static int64_t now_us(void) {
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return now.tv_sec * 1000000ll + now.tv_nsec / 1000;
}

static void wait_until(int64_t us) {
    const struct timespec until = {us / 1000000, us % 1000000 * 1000};
    clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &until, NULL);
}

static int load(const char *file) {
    uint32_t size = 0, start = 0;
    uint8_t *code = read_ihex_file(file, &size, &start);
    avr = avr_make_mcu_by_name(CHIP);
    if (!code || !avr) {
        return -1;
    }
    avr_init(avr);
    avr->frequency = CYCLES_PER_US * 1000000u;
    avr->log = LOG_ERROR;
    avr->sleep = sleep_for;
    reset_chip = avr->reset;
    avr->reset = on_reset;
    avr_loadcode(avr, code, size, start);
    avr->codeend = size + start;
    free(code);
    return 0;
}

static void connect_pins(void) {
    uint32_t flags = 0;
    avr_ioctl(avr, AVR_IOCTL_UART_SET_FLAGS('0'), &flags); /* simavr neither prints the bytes nor sleeps on them */
    avr_irq_register_notify(avr_io_getirq(avr, AVR_IOCTL_UART_GETIRQ('0'), UART_IRQ_OUTPUT), on_byte, NULL);
    connect_plant(avr, note_force);
}

static int run(void) {
    avr_cycle_count_t target = avr->cycle;
    int64_t due = now_us();
    while (!stopped) {
        target += SLICE_US * CYCLES_PER_US;
        due += SLICE_US;
        if (target > avr->cycle) {
            avr_cycle_timer_register(avr, target - avr->cycle, end_of_slice, NULL);
        }
        while (avr->cycle < target) {
            const int state = avr_run(avr);
            if (state == cpu_Done || state == cpu_Crashed) {
                fprintf(stderr, "the firmware crashed\n");
                return 1;
            }
        }
        if (send_bytes()) {
            (void)poll(&(struct pollfd){port, POLLIN, 0}, 1, GIVES_UP_MS);
            due = now_us() - MOST_BEHIND_US; /* the next sample starts at once */
        }
        wait_until(due);
        if (now_us() > due + MOST_BEHIND_US) {
            due = now_us() - MOST_BEHIND_US;
        }
        receive_bytes();
    }
    return 0;
}

int main(int count, char **words) {
    char path[64];
    for (int i = 3; i < count; i++) {
        if (sscanf(words[i], "lockstep=%d", &lockstep) != 1 && !set_plant(words[i])) {
            fprintf(stderr, "%s: expected lockstep=1 or, of an analogue board, one of its properties:\n", words[i]);
            tell_plant();
            return 2;
        }
    }
    if (count < 2 || load(words[1]) != 0) {
        fprintf(stderr, "usage: run_avr FIRMWARE.hex [LOG [NAME=NUMBER ...]]\n");
        return 2;
    }
    port = open_terminal(path, sizeof path);
    if (port < 0) {
        fprintf(stderr, "no pseudo-terminal is to be had\n");
        return 3;
    }
    if (count > 2) {
        log_file = open(words[2], O_WRONLY | O_CREAT | O_TRUNC, 0666);
    }
    signal(SIGTERM, stop);
    signal(SIGINT, stop);
    prctl(PR_SET_TIMERSLACK, 1);
    connect_pins();
    mend_chip(avr); /* before watch_cycles: simavr calls the last observer first, and it counts the cycles added here */
    watch_cycles(avr);
    printf("%s\n", path);
    fflush(stdout);
    const int status = run();
    note_force(avr->cycle, 0);
    tell_cycles(stderr);
    tell_wire(stderr);
    return status;
}
