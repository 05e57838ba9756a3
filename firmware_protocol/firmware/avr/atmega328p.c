/* SPDX-License-Identifier: MIT */
/* Compare match B of timer 1 makes the tick; it can start the analogue converter too. The receiver's interrupt only
 * puts bytes into a ring. At 2 Mbaud a byte lasts 80 cycles, and the receiver itself keeps two bytes. So nothing may
 * disable interrupts for longer than two bytes last: the tick's interrupt enables others at once. */
#include "atmega328p.h"

#include "hapsim_device.h"
#include "hapsim_port.h"
#include <hapsim_board.h> /* that of the board being built, not the one beside this file */

#include <avr/interrupt.h>
#include <avr/io.h>
#include <avr/sleep.h>
#include <avr/wdt.h>

#define RING 256 /* as many as a byte counts before it wraps */

/* One context writes `end`, the other writes `start`. Each is one byte, so neither needs a lock. */
typedef struct {
    uint8_t bytes[RING];
    volatile uint8_t start, end;
} ring;

static ring received, to_send;
static uint32_t ticks; /* clock at the last tick */
static volatile bool tick_held, tick_due;
#ifdef HAPSIM_BOARD_STEPS
#define TIMER_TICKS (HAPSIM_BOARD_PERIOD_TICKS / HAPSIM_BOARD_STEPS)
static volatile bool step_due; /* tick_held holds off steps; no tick begins within a tick */
static bool ticking;
#else
#define TIMER_TICKS HAPSIM_BOARD_PERIOD_TICKS
#endif
static volatile bool overrun; /* the ring of received bytes ran over since the last check */

/* received.bytes[end++] = UDR0; if (end == received.start) overrun = true; this takes 46 of the 80 cycles that a byte
 * lasts. The compiler's version takes 60. While bytes come without a pause, that would leave the tick and the main loop
 * 20 cycles instead of 34.
 *
 * The ring keeps the newest bytes: after noise of any length, the next frame is among them. */
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

#ifdef HAPSIM_BOARD_STEPS
/* Enables steps and the tick again, and runs those that came meanwhile. Steps interrupt the tick. */
void hapsim_port_let_tick(void) {
    for (;;) {
        cli();
        const bool is_step = step_due, is_tick = !is_step && tick_due && !ticking;
        tick_held = is_step;
        step_due = false;
        if (is_tick) {
            ticking = true;
            tick_due = false;
        }
        sei();
        if (is_step) {
            tick_due |= board_step();
        } else if (is_tick) {
            board_tick();
            ticking = false;
        } else {
            return;
        }
    }
}
#else
/* Enables the tick again, and runs a tick that came meanwhile. */
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
#endif

/* Interrupts are enabled at once: bytes may come during a tick, and so may the next tick, which then only sets
 * tick_due. The interrupts for bytes do not read the clock, so nothing sees a half-written `ticks`. */
ISR(TIMER1_COMPB_vect, ISR_NOBLOCK) {
    ticks += TIMER_TICKS;
#ifdef HAPSIM_BOARD_STEPS
    step_due = true;
#else
    tick_due = true;
#endif
    if (!tick_held) {
        tick_held = true;
        hapsim_port_let_tick();
    }
}

/* A compare match whose interrupt has not run yet is in the counter, but not yet in `ticks`. */
uint32_t hapsim_port_now(void) {
    const uint8_t before = SREG;
    cli();
    uint16_t count = TCNT1;
    if ((TIFR1 & _BV(OCF1B)) && count < TIMER_TICKS / 2) {
        count = (uint16_t)(count + TIMER_TICKS);
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

/* Called by the tick, or while the tick is held off, so never twice at once. */
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

/* After a watchdog reset the watchdog still runs, with its shortest timeout. It must be stopped before memory is
 * cleared. */
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
    OCR1A = OCR1B = TIMER_TICKS - 1;
    TCCR1B = _BV(WGM12) | _BV(CS11);
    TIMSK1 = _BV(OCIE1B);
    wdt_enable(WDTO_60MS);
    set_sleep_mode(SLEEP_MODE_IDLE);
}

/* Drops the oldest half of the ring, so that the newest half can be read before it is overwritten. */
static void drop_oldest(void) {
    cli();
    received.start = (uint8_t)(received.end - RING / 2);
    overrun = false;
    sei();
    hapsim_device_lost_bytes();
    GPIOR2 = 2; /* run_avr counts these */
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
    GPIOR2 = 1; /* run_avr measures how long this takes */
    hapsim_device_take_byte(byte);
    GPIOR2 = 0;
    return true;
}

/* Sleeps until the next interrupt, unless a byte has come since the last check. */
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
#ifdef HAPSIM_BROKEN_TICK /* the tick dies half a second after arming: the hardware watchdog must reset the chip */
        if (hapsim_device_register(HAPSIM_REG_ACCEPTED) > 500) {
            TCCR1B = 0;
        }
#endif
    }
}
