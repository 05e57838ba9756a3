/* SPDX-License-Identifier: MIT */
#include "hardware.h"

#include "mps2.h"

#ifndef SIMULATED_STEPS
#define SIMULATED_STEPS 1 /* SysTicks in a sample; more on a board that follows lines */
#endif

#define CYCLES_PER_US 25u
#define BYTES_PRIORITY 0x40u
#define WATCHDOG_PERIODS 30u /* until its warning; the reset follows after as many again */

void on_uart0_received(void);
void on_uart0_sent(void);
void on_timer1(void);

/* One context writes `end`, the other writes `start`. Both only count up. */
typedef struct {
    volatile uint32_t start, end;
    uint8_t bytes[RING];
} ring;

static ring received, to_send;

/* Keeps the newest bytes: after noise of any length, the next frame is among them. */
void on_uart0_received(void) {
    UART0->interrupts = UART_RECEIVED;
    while (UART0->state & UART_RECEIVER_FULL) {
        received.bytes[received.end % RING] = (uint8_t)UART0->data;
        received.end++;
    }
}

static void send_next(void) {
    while (to_send.start != to_send.end && !(UART0->state & UART_TRANSMITTER_FULL)) {
        UART0->data = to_send.bytes[to_send.start % RING];
        to_send.start++;
    }
}

void on_uart0_sent(void) {
    UART0->interrupts = UART_SENT;
    send_next();
}

/* Only wakes the main loop. */
void on_timer1(void) {
    TIMER1->interrupts = 1;
}

void keep_out(uint32_t priority) {
    __asm volatile("msr basepri, %0\n\tdsb\n\tisb" : : "r"(priority) : "memory");
}

void call_for_tick(void) {
    INTERRUPT_CONTROL = PENDSV_PENDING_SET;
}

int bytes_to_read(void) {
    return (int)(received.end - received.start);
}

int next_byte(void) {
    const uint32_t end = received.end;
    if (end - received.start > RING) { /* the ring ran over: drop the oldest half, before the rest is overwritten too */
        received.start = end - RING / 2;
        return BYTES_WERE_LOST;
    }
    if (received.start == end) {
        return NOTHING_CAME;
    }
    const uint8_t byte = received.bytes[received.start % RING];
    received.start++;
    return byte;
}

size_t room_to_send(void) {
    return RING - (to_send.end - to_send.start);
}

/* Receiver and transmitter have one priority. So the receiver is held off, too, while the first byte is sent. */
void send_bytes(const uint8_t *bytes, size_t count) {
    uint32_t end = to_send.end;
    for (size_t i = 0; i < count; i++) {
        to_send.bytes[end++ % RING] = bytes[i];
    }
    uint32_t before;
    __asm volatile("mrs %0, basepri" : "=r"(before));
    keep_out(BYTES_PRIORITY);
    to_send.end = end;
    send_next();
    keep_out(before);
}

void rest(void) {
    __asm volatile("cpsid i" : : : "memory");
    if (received.start == received.end) {
        __asm volatile("wfi" : : : "memory");
    }
    __asm volatile("cpsie i" : : : "memory");
}

static void in_hexadecimal(char *text, uint32_t word) {
    for (int i = 7; i >= 0; i--, word >>= 4) {
        text[i] = "0123456789abcdef"[word & 15u];
    }
}

/* Writes the whole line in one call. */
void note_force(uint32_t us, int32_t counts) {
    static char line[] = "00000000 00000000\n";
    in_hexadecimal(line, us);
    in_hexadecimal(line + 9, (uint32_t)counts);
    register uint32_t write_text __asm("r0") = 4;
    register const char *text __asm("r1") = line;
    __asm volatile("bkpt 0xab" : "+r"(write_text) : "r"(text) : "memory");
}

void begin_period(void) {
    SYSTICK->value = 0;
    INTERRUPT_CONTROL = SYSTICK_PENDING_CLEAR;
}

void feed_watchdog(void) {
    WATCHDOG_LOCK = WATCHDOG_KEY;
    WATCHDOG->clear = 1;
    WATCHDOG_LOCK = 0;
}

uint32_t now_us(void) {
    return ~TIMER0->value / CYCLES_PER_US;
}

void wake_often(bool often) {
    TIMER1->control = often ? 9 : 0; /* counts, interrupts */
}

void start_hardware(void) {
    const uint32_t period = 1000 * CYCLES_PER_US;

    UART0->divider = 16;
    UART0->control = UART_SENDS | UART_RECEIVES | UART_SENT_INTERRUPTS | UART_INTERRUPTS;
    TIMER0->reload = 0xffffffffu;
    TIMER0->value = 0xffffffffu;
    TIMER0->control = 1;
    INTERRUPT_PRIORITY[0] = BYTES_PRIORITY;
    INTERRUPT_PRIORITY[1] = BYTES_PRIORITY;
    SYSTICK_PRIORITY = TIMER_PRIORITY;
    PENDSV_PRIORITY = TICK_PRIORITY;
    TIMER1->reload = period / 2;
    INTERRUPT_PRIORITY[9] = TICK_PRIORITY;
    INTERRUPT_ENABLE = 1u << 0 | 1u << 1 | 1u << 9;
    SYSTICK->reload = period / SIMULATED_STEPS - 1;
    SYSTICK->value = 0;
    SYSTICK->control = 7; /* counts cycles, interrupts */
    WATCHDOG_LOCK = WATCHDOG_KEY;
    WATCHDOG->load = WATCHDOG_PERIODS * period;
    WATCHDOG->control = 3; /* warns first, then resets unless it is fed */
    WATCHDOG_LOCK = 0;
}
