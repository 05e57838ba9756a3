/* SPDX-License-Identifier: MIT */
/* simavr takes the time of a byte from U2X at the moment when UBRR is written, and counts a parity bit that is not
 * sent. It queues 64 bytes and drops any more. So this file delivers bytes one by one, at the firmware's baud rate. A
 * byte that finds two unread bytes is lost, as on the chip (which loses it when the next one begins). */
#include "chip.h"

#include <avr_uart.h>
#include <sim_interrupts.h>
#include <sim_io.h>
#include <string.h>

#define KEPT 2u     /* unread bytes that the receiver keeps */
#define ENTERING 4u /* cycles to enter an interrupt */
#define UCSR0A 0xc0
#define U2X0 2u
#define UBRR0L 0xc4
#define UBRR0H 0xc5
#define VECTORS 25u
#define WIRE 64u /* bytes: a power of two */

static avr_t *chip;
static avr_uart_t *uart;
static avr_irq_t *receiver;
static uint8_t wire[WIRE];
static size_t put, arrived;
static unsigned long lost;

/* Returns the cycles of ten bits at the baud rate that the firmware has set. */
static uint32_t cycles_per_byte(void) {
    const uint32_t divisor = (chip->data[UBRR0L] | (uint32_t)(chip->data[UBRR0H] & 15) << 8) + 1;
    return 10u * divisor * (chip->data[UCSR0A] & U2X0 ? 8u : 16u);
}

static unsigned unread(void) {
    return (unsigned)(uart->input.write - uart->input.read) % uart_fifo_fifo_size;
}

/* Gives the receiver a byte whose time on the wire is over. The flag must rise at once, so the receiver's own time is 1
 * cycle. */
static void receive(uint8_t byte) {
    if (unread() >= KEPT) {
        lost++;
        return;
    }
    uart->cycles_per_byte = 1;
    avr_raise_irq(receiver, byte);
    uart->cycles_per_byte = cycles_per_byte();
}

static avr_cycle_count_t on_arrival(avr_t *avr, avr_cycle_count_t when, void *unused) {
    (void)avr, (void)unused;
    receive(wire[arrived++ % WIRE]);
    return put > arrived ? when + cycles_per_byte() : 0;
}

size_t wire_room(void) {
    return WIRE - (put - arrived);
}

void put_on_wire(const uint8_t *bytes, size_t count) {
    for (size_t i = 0; i < count; i++) {
        wire[put++ % WIRE] = bytes[i];
    }
    /* A reset of the chip clears its timers, but not the bytes on the wire. */
    if (put > arrived && avr_cycle_timer_status(chip, on_arrival, NULL) == 0) {
        avr_cycle_timer_register(chip, cycles_per_byte(), on_arrival, NULL);
    }
}

static void on_interrupt(avr_irq_t *irq, uint32_t begins, void *unused) {
    (void)irq, (void)unused;
    if (begins) {
        chip->cycle += ENTERING;
    }
}

/* The flag stays set as long as a byte is unread; simavr would check for the second byte only one byte time later. */
static void on_received(avr_irq_t *irq, uint32_t begins, void *unused) {
    (void)irq, (void)unused;
    if (!begins && unread()) {
        avr_raise_interrupt(chip, &uart->rxc);
    }
}

void mend_chip(avr_t *avr) {
    chip = avr;
    for (avr_io_t *io = avr->io_port; io; io = io->next) {
        if (!strcmp(io->kind, "uart")) {
            uart = (avr_uart_t *)io;
        }
    }
    avr_irq_register_notify(avr_get_interrupt_irq(avr, uart->rxc.vector) + AVR_INT_IRQ_RUNNING, on_received, NULL);
    receiver = avr_io_getirq(avr, AVR_IOCTL_UART_GETIRQ('0'), UART_IRQ_INPUT);
    for (uint8_t vector = 1; vector <= VECTORS; vector++) {
        avr_irq_t *irq = avr_get_interrupt_irq(avr, vector);
        if (irq) {
            avr_irq_register_notify(irq + AVR_INT_IRQ_RUNNING, on_interrupt, NULL);
        }
    }
}

void tell_wire(FILE *to) {
    fprintf(to, "%lu bytes arrived, %lu lost because two were unread\n", (unsigned long)arrived, lost);
}
