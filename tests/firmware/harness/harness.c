/* The state machine alone, in virtual time: obeys lines of standard input, and after each one tells what came of it as
 * `STATE FED OUT FORCE...`, OUT in hexadecimal or -. With a digital word the outputs follow; with a servo its commands,
 * or `none` while it has no torque.
 *
 *   bytes HEX            bytes of the host
 *   tick                 a sample period passes, and the sample timer ticks (with lines: the step's timer, as often)
 *   step                 a local period passes
 *   pass THOUSANDTHS     so much of a period passes, and the main loop comes round
 *   position COUNT...    what is measured from now on,
 *   velocity COUNT...    and this,
 *   acceleration COUNT...    and this
 *   hand_force COUNT...      and this
 *   inputs WORD          and this,
 *   fault NUMBER         what measuring finds from now on: 0 nothing
 *   room 0|1             whether the transmitter takes frames
 *   register NUMBER      tells its value alone
 */
#include "hapsim_board.h"
#include "hapsim_device.h"
#include "hapsim_port.h"

#include <stdio.h>
#include <stdlib.h>

#ifdef HARNESS_KNOB /* then knob.cpp is the board, and obeys some more lines */
#define SHARED
void knob_obey(const char *line);
#else
#define SHARED static
static unsigned held_off;
#endif

SHARED uint32_t now;
SHARED int32_t measured[4 * HAPSIM_BOARD_CHANNELS], put_out[HAPSIM_BOARD_CHANNELS];
#if HAPSIM_BOARD_DIGITAL_WORD
static uint32_t inputs, outputs = 12345;

uint32_t hapsim_port_read_inputs(void) {
    return inputs;
}

void hapsim_port_put_outputs(uint32_t word) {
    outputs = word;
}
#endif
#ifdef HAPSIM_BOARD_SPEED_LIMIT
static int32_t commands[HAPSIM_BOARD_CHANNELS];
static bool serving = true; /* so that powering up has to end it */
#endif
SHARED uint8_t found = HAPSIM_NO_FAULT;
SHARED bool room = true;
SHARED unsigned fed;
SHARED uint8_t said[4096];
SHARED size_t said_bytes;

#ifndef HARNESS_KNOB
uint32_t hapsim_port_now(void) {
    return now;
}

uint8_t hapsim_port_measure(int32_t *counts, uint8_t parts) {
    const size_t each = HAPSIM_BOARD_CHANNELS;
    memcpy(counts, measured, each * sizeof *counts);
    if (parts & HAPSIM_WITH_VELOCITY) {
        memcpy(counts += each, measured + each, each * sizeof *counts);
    }
    if (parts & HAPSIM_WITH_ACCELERATION) {
        memcpy(counts += each, measured + 2 * each, each * sizeof *counts);
    }
    if (parts & HAPSIM_WITH_FORCE) {
        memcpy(counts + each, measured + 3 * each, each * sizeof *counts);
    }
    return found;
}

void hapsim_port_put_forces(const int32_t *counts) {
    memcpy(put_out, counts, sizeof put_out);
#ifdef HAPSIM_BOARD_SPEED_LIMIT
    serving = false;
#endif
}

#ifdef HAPSIM_BOARD_SPEED_LIMIT
void hapsim_port_put_commands(const int32_t *counts) {
    memcpy(commands, counts, sizeof commands);
    serving = true;
}
#endif

bool hapsim_port_write(const uint8_t *bytes, size_t count) {
    if (!room || said_bytes + count > sizeof said) {
        return false;
    }
    memcpy(said + said_bytes, bytes, count);
    said_bytes += count;
    return true;
}

void hapsim_port_feed_watchdog(void) {
    fed++;
}

void hapsim_port_begin(void) {}

void hapsim_port_hold_tick(void) {
    if (held_off++) {
        abort(); /* one context holds it, and once */
    }
}

void hapsim_port_let_tick(void) {
    if (--held_off) {
        abort();
    }
}
#endif

static void take_bytes(const char *hex) {
    unsigned value;
    for (; sscanf(hex, "%2x", &value) == 1; hex += 2) {
        hapsim_device_take_byte((uint8_t)value);
    }
}

static void read_counts(char *text, int32_t *counts) {
    for (int c = 0; c < HAPSIM_BOARD_CHANNELS; c++) {
        counts[c] = (int32_t)strtol(text, &text, 10);
    }
}

static void tell(void) {
    printf("%u %u ", hapsim_device_state(), fed);
    for (size_t i = 0; i < said_bytes; i++) {
        printf("%02x", said[i]);
    }
    printf("%s", said_bytes ? "" : "-");
    for (int c = 0; c < HAPSIM_BOARD_CHANNELS; c++) {
        printf(" %ld", (long)put_out[c]);
    }
#if HAPSIM_BOARD_DIGITAL_WORD
    printf(" %lu", (unsigned long)outputs);
#endif
#ifdef HAPSIM_BOARD_SPEED_LIMIT
    for (int c = 0; c < HAPSIM_BOARD_CHANNELS; c++) {
        if (serving) {
            printf(" %ld", (long)commands[c]);
        } else {
            printf(" none");
        }
    }
#endif
    printf("\n");
    said_bytes = 0;
}

static void step(uint32_t in_sample) {
#ifdef HAPSIM_BOARD_STEPS
    now += HAPSIM_BOARD_PERIOD_TICKS / in_sample;
    if (hapsim_device_step()) {
        hapsim_device_tick();
    }
#else
    now += HAPSIM_BOARD_PERIOD_TICKS / in_sample;
    hapsim_device_tick();
#endif
}

#ifndef HAPSIM_BOARD_STEPS
#define HAPSIM_BOARD_STEPS 1
#endif

static void obey(char *line) {
    char *rest = line + strcspn(line, " \n");
    if (strncmp(line, "bytes", 5) == 0) {
        take_bytes(rest + 1);
    } else if (strncmp(line, "tick", 4) == 0) {
        for (int i = 0; i < HAPSIM_BOARD_STEPS; i++) {
            step(HAPSIM_BOARD_STEPS);
        }
    } else if (strncmp(line, "step", 4) == 0) {
        step(HAPSIM_BOARD_STEPS);
    } else if (strncmp(line, "pass", 4) == 0) {
        now += (uint32_t)strtoul(rest, NULL, 10);
        hapsim_device_look();
    } else if (strncmp(line, "position", 8) == 0) {
        read_counts(rest, measured);
    } else if (strncmp(line, "velocity", 8) == 0) {
        read_counts(rest, measured + HAPSIM_BOARD_CHANNELS);
    } else if (strncmp(line, "acceleration", 12) == 0) {
        read_counts(rest, measured + 2 * HAPSIM_BOARD_CHANNELS);
    } else if (strncmp(line, "hand_force", 10) == 0) {
        read_counts(rest, measured + 3 * HAPSIM_BOARD_CHANNELS);
#if HAPSIM_BOARD_DIGITAL_WORD
    } else if (strncmp(line, "inputs", 6) == 0) {
        inputs = (uint32_t)strtoul(rest, NULL, 10);
#endif
    } else if (strncmp(line, "fault", 5) == 0) {
        found = (uint8_t)strtoul(rest, NULL, 10);
    } else if (strncmp(line, "lost", 4) == 0) {
        hapsim_device_lost_bytes();
    } else if (strncmp(line, "room", 4) == 0) {
        room = strtoul(rest, NULL, 10) != 0;
    }
#ifdef HARNESS_KNOB
    knob_obey(line);
#endif
}

int main(void) {
    static char line[65536];
    for (int c = 0; c < HAPSIM_BOARD_CHANNELS; c++) {
        put_out[c] = 12345; /* so that powering up has to put out zero */
    }
    now = UINT32_MAX - 5000; /* the clock wraps soon */
    hapsim_device_init();
    while (fgets(line, sizeof line, stdin)) {
        if (strncmp(line, "register", 8) == 0) {
            printf("%lu\n", (unsigned long)hapsim_device_register((uint16_t)strtoul(line + 8, NULL, 10)));
        } else {
            obey(line);
            tell();
        }
    }
    return 0;
}
