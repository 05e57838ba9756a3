/* SPDX-License-Identifier: MIT */
/* Timer 1 makes the tick, by its compare match B, which can start the analogue converter too. The receiver's interrupt
 * puts bytes into a ring and does nothing else; at 2 Mbaud it has 80 cycles for each, so nothing else may hold interrupts
 * off for longer than two bytes last, which the receiver keeps itself: the tick's interrupt lets others in at once. */
#include "atmega328p.h"

#include "hapsim_device.h"
#include "hapsim_port.h"
#include <hapsim_board.h> /* of the board that is built, not the one beside this file */

#include <avr/interrupt.h>
#include <avr/io.h>
#include <avr/sleep.h>
#include <avr/wdt.h>

#define RING 256 /* what a byte counts before it begins anew by itself */

/* One context writes `end`, the other one `start`: a byte each, so that neither needs a lock. */
typedef struct {
    uint8_t bytes[RING];
    volatile uint8_t start, end;
} ring;

static ring received, to_send;
static uint32_t ticks; /* clock at the last tick */
static volatile bool tick_held, tick_due;
static volatile bool overrun; /* of the ring of received bytes, since it was looked at */

/* received.bytes[end++] = UDR0; overrun = end == received.start; in 46 cycles of the 80 that a byte lasts, all told. The
 * compiler's own takes 60, which leaves the tick and the main loop 20 in place of 34 while bytes come without a pause.
 *
 * The newest bytes are kept: after noise of any length the frame that follows it is among them. */
ISR(USART_RX_vect, ISR_NAKED) {
    __asm__ volatile("push r24            \n\t"
                     "in   r24, __SREG__  \n\t"
                     "push r24            \n\t"
                     "push r30            \n\t"
                     "push r31            \n\t"
                     "lds  r30, %[end]    \n\t"
                     "ldi  r31, 0         \n\t"
                     "subi r30, lo8(-(%[bytes])) \n\t"
                     "sbci r31, hi8(-(%[bytes])) \n\t"
                     "lds  r24, %[udr]    \n\t"
                     "st   Z, r24         \n\t"
                     "subi r30, lo8(%[bytes] - 1) \n\t"
                     "sts  %[end], r30    \n\t"
                     "lds  r24, %[start]  \n\t"
                     "cp   r24, r30       \n\t"
                     "brne 1f             \n\t"
                     "ldi  r24, 1         \n\t"
                     "sts  %[overrun], r24 \n"
                     "1:                  \n\t"
                     "pop  r31            \n\t"
                     "pop  r30            \n\t"
                     "pop  r24            \n\t"
                     "out  __SREG__, r24  \n\t"
                     "pop  r24            \n\t"
                     "reti                \n\t" ::[end] "i"(&received.end),
                     [start] "i"(&received.start), [bytes] "i"(received.bytes), [overrun] "i"(&overrun),
                     [udr] "i"(&UDR0));
}

ISR(USART_UDRE_vect) {
    const uint8_t start = to_send.start;
    if (start == to_send.end) {
        UCSR0B &= (uint8_t)~_BV(UDRIE0);
        return;
    }
    UDR0 = to_send.bytes[start];
    to_send.start = (uint8_t)(start + 1u);
}

void hapsim_port_hold_tick(void) {
    tick_held = true;
}

/* A tick that came meanwhile is made up for here. */
void hapsim_port_let_tick(void) {
    for (;;) {
        cli();
        tick_held = tick_due;
        tick_due = false;
        sei();
        if (!tick_held) {
            return;
        }
        board_tick();
    }
}

/* Interrupts are let in at once: bytes come during a tick, and so may the next tick, which finds this one at work.
 * Neither of the bytes' interrupts asks for the time, so nothing sees `ticks` half counted. */
ISR(TIMER1_COMPB_vect, ISR_NOBLOCK) {
    ticks += HAPSIM_BOARD_PERIOD_TICKS;
    tick_due = true;
    if (!tick_held) {
        tick_held = true;
        hapsim_port_let_tick();
    }
}

/* A match that has not been served yet is in the counter, but not in `ticks`. */
uint32_t hapsim_port_now(void) {
    const uint8_t before = SREG;
    cli();
    uint16_t count = TCNT1;
    if ((TIFR1 & _BV(OCF1B)) && count < HAPSIM_BOARD_PERIOD_TICKS / 2) {
        count = (uint16_t)(count + HAPSIM_BOARD_PERIOD_TICKS);
    }
    const uint32_t now = ticks + count;
    SREG = before;
    return now;
}

void hapsim_port_begin(void) {
    const uint8_t before = SREG;
    cli();
    TCNT1 = 0;
    TIFR1 = _BV(OCF1B);
    SREG = before;
    board_begin();
}

/* Called by the tick, or while the tick is held off: never by two at once. */
bool hapsim_port_write(const uint8_t *bytes, size_t count) {
    uint8_t end = to_send.end;
    const uint8_t room = (uint8_t)(to_send.start - end - 1u);
    if (count > room) {
        return false;
    }
    for (uint8_t i = 0; i < count; i++) {
        to_send.bytes[end] = bytes[i];
        end = (uint8_t)(end + 1u);
    }
    to_send.end = end;
    UCSR0B = _BV(RXEN0) | _BV(TXEN0) | _BV(RXCIE0) | _BV(UDRIE0);
    return true;
}

void hapsim_port_feed_watchdog(void) {
    wdt_reset();
}

/* After a reset by the watchdog it runs on, at its shortest: it has to be stopped before memory is even cleared. */
void stop_watchdog(void) __attribute__((naked, used, section(".init3")));
void stop_watchdog(void) {
    MCUSR = 0;
    wdt_disable();
}

static void start_hardware(void) {
    UBRR0 = (F_CPU / 8 + HAPSIM_BAUD / 2) / HAPSIM_BAUD - 1;
    UCSR0A = _BV(U2X0);
    UCSR0C = _BV(UCSZ01) | _BV(UCSZ00); /* 8 data bits, no parity, 1 stop bit */
    UCSR0B = _BV(RXEN0) | _BV(TXEN0) | _BV(RXCIE0);
    TCCR1A = 0;
    OCR1A = OCR1B = HAPSIM_BOARD_PERIOD_TICKS - 1;
    TCCR1B = _BV(WGM12) | _BV(CS11);
    TIMSK1 = _BV(OCIE1B);
    wdt_enable(WDTO_60MS);
    set_sleep_mode(SLEEP_MODE_IDLE);
}

/* The oldest half goes, so that the newest one can be read before it is overwritten too. */
static void drop_oldest(void) {
    cli();
    received.start = (uint8_t)(received.end - RING / 2);
    overrun = false;
    sei();
    hapsim_device_lost_bytes();
    GPIOR2 = 2; /* for an observer: how often */
}

static bool take_byte(void) {
    if (overrun) {
        drop_oldest();
    }
    const uint8_t start = received.start;
    if (start == received.end) {
        return false;
    }
    const uint8_t byte = received.bytes[start];
    received.start = (uint8_t)(start + 1u);
    GPIOR2 = 1; /* for an observer: how long it takes */
    hapsim_device_take_byte(byte);
    GPIOR2 = 0;
    return true;
}

/* Sleeps until the next interrupt, unless a byte came after it was looked for. */
static void rest(void) {
    cli();
    if (received.start == received.end && !overrun) {
        sleep_enable();
        sei();
        sleep_cpu();
        sleep_disable();
    }
    sei();
}

int main(void) {
    board_start();
    hapsim_device_init();
    start_hardware();
    sei();
    for (;;) {
        while (take_byte()) {
        }
        if (!hapsim_device_look()) {
            rest();
        }
#ifdef HAPSIM_BROKEN_TICK /* half a second after arming the tick dies: the hardware watchdog has to see it */
        if (hapsim_device_register(HAPSIM_REG_ACCEPTED) > 500) {
            TCCR1B = 0;
        }
#endif
    }
}
