/* SPDX-License-Identifier: MIT */
#include "cycles.h"

#include <sim_interrupts.h>

#define GPIOR2 0x4b
#define RAN_OVER 2   /* the firmware writes this to GPIOR2 when its ring ran over */
#define RETURNING 4u /* cycles of the return, after simavr reports the interrupt's end */

typedef struct {
    const char *what;
    uint8_t vector; /* 0: measured between two writes to GPIOR2 */
    avr_cycle_count_t begun, least, most, sum;
    unsigned long times;
} stretch;

static avr_t *chip;
static unsigned long overruns;
static stretch stretches[] = {
    {"a byte received, its interrupt", 18, 0, 0, 0, 0, 0},
    {"a byte sent, its interrupt", 19, 0, 0, 0, 0, 0},
    {"a tick while armed, with what interrupts it", 12, 0, 0, 0, 0, 0},
    {"a byte within a frame, main loop", 0, 0, 0, 0, 0, 0},
    {"a frame's last byte, main loop, with what interrupts it", 0, 0, 0, 0, 0, 0},
};
enum { KINDS = sizeof stretches / sizeof *stretches, BYTE = 3, FRAME = 4, MANY = 1000, TICK = 12 };

static void add(stretch *one, avr_cycle_count_t cycles) {
    one->times++;
    one->sum += cycles;
    one->least = one->times == 1 || cycles < one->least ? cycles : one->least;
    one->most = cycles > one->most ? cycles : one->most;
}

static void on_interrupt(avr_irq_t *irq, uint32_t begins, void *which) {
    stretch *one = which;
    (void)irq;
    if (begins) {
        one->begun = chip->cycle;
    } else if (one->begun) {
        const avr_cycle_count_t cycles = chip->cycle + RETURNING - one->begun;
        if (one->vector != TICK || cycles > MANY) { /* shorter ones are those of an idle device */
            add(one, cycles);
        }
        one->begun = 0;
    }
}

/* A frame's check takes so much longer than a byte that its duration identifies it. */
static void on_gpior2(avr_t *avr, avr_io_addr_t address, uint8_t value, void *unused) {
    static avr_cycle_count_t begun;
    (void)unused;
    avr->data[address] = value;
    if (value == RAN_OVER) {
        overruns++;
    } else if (value) {
        begun = avr->cycle;
    } else {
        const avr_cycle_count_t cycles = avr->cycle - begun;
        add(&stretches[cycles > MANY ? FRAME : BYTE], cycles);
    }
}

void watch_cycles(avr_t *avr) {
    chip = avr;
    for (int i = 0; i < BYTE; i++) {
        avr_irq_t *irq = avr_get_interrupt_irq(avr, stretches[i].vector);
        avr_irq_register_notify(irq + AVR_INT_IRQ_RUNNING, on_interrupt, &stretches[i]);
    }
    avr_register_io_write(avr, GPIOR2, on_gpior2, NULL);
}

void tell_cycles(FILE *to) {
    fprintf(to, "%-56s %8s %8s %8s %8s\n", "cycles", "times", "least", "mean", "most");
    for (int i = 0; i < KINDS; i++) {
        const stretch *one = &stretches[i];
        fprintf(to, "%-56s %8lu %8lu %8lu %8lu\n", one->what, one->times, (unsigned long)one->least,
                (unsigned long)(one->times ? one->sum / one->times : 0), (unsigned long)one->most);
    }
    fprintf(to, "the receiver's ring ran over %lu times\n", overruns);
}
