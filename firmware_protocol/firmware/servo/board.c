/* SPDX-License-Identifier: MIT */
/* The firmware as a Linux process whose servo follows position commands, with a simulated hand on its handle:
 * `linux_servo [LOG [KEY=VALUE ...]]` prints its port's path and serves the port until it is stopped.
 *
 *     stiffness, damping   of the hand, N/m and N s/m [300, 5]
 *     swing                way of the hand to and fro, every two seconds from arming on, m [0]
 *     fault                of the force sensor: dead, inverted, saturated or drifting (5 N/s), from sample `at` on [0]
 *
 * LOG gets a line for each tick, in hexadecimal: microseconds of the process's clock, position and command in counts,
 * whether the servo has torque, and the FORCE frames acted on. Without torque the handle stands still, as a geared one does.
 */
#define _GNU_SOURCE
#include "hapsim_board.h"
#include "hapsim_device.h"
#include "hapsim_port.h"
#include "process.h"

#include <fcntl.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <unistd.h>

#define PERIOD 1e-3 /* s */
#define NATURAL (2 * 3.14159265358979323846 * 50)
#define SWING_S 2.0
#define DRIFT 5e-3 /* N per sample */
#define COUNT 1e-9
#define FORCE_COUNT 1e-6
#define RANGE_COUNTS 100000000

static double stiffness = 300, damping = 5, swing;
static char fault[16];
static unsigned long faulty_from;
static int log_file = -1;
static unsigned long sample;
static double position, velocity, command;
static bool has_torque;
static int32_t sensed;

/* Critically damped: exact for a held command. */
static void move_handle(void) {
    if (has_torque) {
        const double decay = exp(-NATURAL * PERIOD), away = position - command, slope = velocity + NATURAL * away;
        position = command + (away + slope * PERIOD) * decay;
        velocity = (velocity - NATURAL * slope * PERIOD) * decay;
    }
}

static double hand_force(void) {
    const double there = swing / 2 * (1 - cos(2 * 3.14159265358979323846 * (double)sample * PERIOD / SWING_S));
    return stiffness * (there - position) - damping * velocity;
}

static int32_t sense_force(void) {
    const bool is_faulty = sample >= faulty_from;
    double force = hand_force() / FORCE_COUNT;
    if (is_faulty && fault[0] == 'i') {
        force = -force;
    } else if (is_faulty && fault[0] == 's') {
        force = RANGE_COUNTS;
    } else if (is_faulty && fault[0] == 'd' && fault[1] == 'r') {
        force += (double)(sample - faulty_from) * DRIFT / FORCE_COUNT;
    } else if (is_faulty && fault[0] == 'd') {
        return sensed;
    }
    return (int32_t)fmax(-RANGE_COUNTS, fmin(RANGE_COUNTS, rint(force)));
}

uint8_t hapsim_port_measure(int32_t *counts, uint8_t parts) {
    const double there = rint(position / COUNT);
    const bool fits = fabs(there) <= INT32_MAX;
    counts[0] = fits ? (int32_t)there : 0;
    sensed = sense_force();
    if (parts & HAPSIM_WITH_FORCE) {
        counts[1] = sensed;
    }
    sample++;
    return fits ? HAPSIM_NO_FAULT : HAPSIM_POSITION_OUT_OF_RANGE;
}

void hapsim_port_put_commands(const int32_t *counts) {
    command = counts[0] * COUNT;
    has_torque = true;
}

void hapsim_port_put_forces(const int32_t *counts) {
    (void)counts;
    has_torque = false;
    velocity = 0;
}

static void note(void) {
    char line[64];
    const unsigned long words[] = {(uint32_t)(process_clock() / 1000), (uint32_t)(int32_t)rint(position / COUNT),
                                   (uint32_t)(int32_t)rint(command / COUNT), has_torque,
                                   hapsim_device_register(HAPSIM_REG_ACCEPTED)};
    const int length = snprintf(line, sizeof line, "%08lx %08lx %08lx %lx %08lx\n", words[0], words[1], words[2], words[3], words[4]);
    if (log_file >= 0 && write(log_file, line, (size_t)length) != length) {
        log_file = -1;
    }
}

static void move_and_note(void) {
    move_handle();
    note();
}

void hapsim_port_feed_watchdog(void) {
    process_feed_watchdog();
}

void hapsim_port_begin(void) {
    process_restart_period();
    sample = 0;
}

/* Returns whether the word is a key of the head comment with a value. */
static bool take(const char *word) {
    return sscanf(word, "stiffness=%lf", &stiffness) == 1 || sscanf(word, "damping=%lf", &damping) == 1 ||
           sscanf(word, "swing=%lf", &swing) == 1 || sscanf(word, "fault=%15s", fault) == 1 ||
           sscanf(word, "at=%lu", &faulty_from) == 1;
}

int main(int count, char **words) {
    if (count > 1) {
        log_file = open(words[1], O_WRONLY | O_CREAT | O_TRUNC, 0666);
    }
    for (int i = 2; i < count; i++) {
        if (!take(words[i])) {
            fprintf(stderr, "%s: expected stiffness=, damping=, swing=, fault= or at=\n", words[i]);
            return 2;
        }
    }
    process_begin_watchdog(NULL);
    hapsim_device_init();
    const int status = process_open();
    if (status != 0) {
        return status;
    }
    process_serve(move_and_note);
    return 0;
}
