/* SPDX-License-Identifier: MIT */
/* The firmware as a Linux process that moves a simulated mass: `linux [LOG [OUTPUTS [SAMPLE:WORD ...]]]` prints its port's
 * path and serves the port until it is stopped.
 *
 * Its inputs are the words of the command line, each from its sample on (hexadecimal WORD). Without any, each input is
 * wired to the output of the same bit. OUTPUTS gets a line for each word of outputs set: the sample from which it acts,
 * and the word, in hexadecimal.
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
#include <unistd.h>

#include "broken.h"

static int log_file = -1, outputs_file = -1, scripted;
static char **script;
static uint32_t sample, outputs;
static simulated_mass mass;
static int32_t force;

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

static void note(int *file, uint32_t when, uint32_t word) {
    char line[32];
    const int length = snprintf(line, sizeof line, "%08lx %08lx\n", (unsigned long)when, (unsigned long)word);
    if (*file >= 0 && write(*file, line, (size_t)length) != length) {
        *file = -1;
    }
}

static void note_force(int32_t counts) {
    note(&log_file, (uint32_t)(process_clock() / 1000), (uint32_t)counts);
}

void hapsim_port_put_forces(const int32_t *counts) {
    force = BROKEN_FORCE(counts[0]);
    note_force(force);
}

/* Each sample reads the inputs once, after the outputs are set. */
uint32_t hapsim_port_read_inputs(void) {
    uint32_t inputs = scripted ? 0 : outputs;
    for (int i = 0; i < scripted; i++) {
        unsigned long from, word;
        if (sscanf(script[i], "%lu:%lx", &from, &word) == 2 && from <= sample) {
            inputs = (uint32_t)word;
        }
    }
    sample++;
    return inputs;
}

void hapsim_port_put_outputs(uint32_t word) {
    outputs = word;
    note(&outputs_file, sample, word);
}

static void note_release(void) {
    note_force(0);
}

void hapsim_port_feed_watchdog(void) {
    process_feed_watchdog();
}

void hapsim_port_begin(void) {
    process_restart_period();
    sample = 0;
    simulated_mass_flick(&mass);
}

static void move_mass(void) {
    simulated_mass_move(&mass, force);
}

int main(int count, char **words) {
    int *files[] = {&log_file, &outputs_file};
    for (int i = 1; i < count && i < 3; i++) {
        *files[i - 1] = open(words[i], O_WRONLY | O_CREAT | O_TRUNC, 0666);
    }
    if (count > 3) {
        script = words + 3;
        scripted = count - 3;
    }
    process_begin_watchdog(note_release);
    hapsim_device_init();
    const int status = process_open();
    if (status != 0) {
        return status;
    }
    process_serve(move_mass);
    note_release();
    return 0;
}
