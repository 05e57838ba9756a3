/* SPDX-License-Identifier: MIT */
/* The firmware on a Cortex-M3: SysTick makes the tick, UART 0 is the port, the interrupt of its receiver comes before the
 * tick. In place of an encoder and a motor there is simulated_mass.c.
 *
 * The emulator logs each force put out, be it the same again: a line of two hexadecimal words: microseconds, and
 * counts. They are those of the ticks: the emulator's clock goes on where its machine holds it up, and ticks are lost.
 * That is done by semihosting: a real chip without a debugger stops at it, so a real board leaves note_force out.
 */
#include "hapsim_board.h"
#include "hapsim_device.h"
#include "hapsim_port.h"
#include "mps2.h"
#include "simulated_mass.h"

#define RING 256u /* a power of two, above the longest frame */
#define TICK_PRIORITY 0x80u
#define BYTES_PRIORITY 0x40u
#define TICK_US 1000u
#define WATCHDOG_PERIODS 30u /* to its first warning; as long again to the reset */

void on_systick(void);
void on_uart0_received(void);
void on_uart0_sent(void);
void on_timer1(void);

/* One context writes `end`, the other one `start`; both count on and on. */
typedef struct {
    volatile uint32_t start, end;
    uint8_t bytes[RING];
} ring;

static ring received, to_send;
static simulated_mass mass;
static int32_t force;
static uint32_t ticks;

/* The newest bytes are kept: after noise of any length the frame that follows it is among them. */
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

/* Wakes the main loop, and that is all. */
void on_timer1(void) {
    TIMER1->interrupts = 1;
}

void on_systick(void) {
    ticks++;
    simulated_mass_move(&mass, force);
    hapsim_device_tick();
}

static void keep_out(uint32_t priority) {
    __asm volatile("msr basepri, %0\n\tdsb\n\tisb" : : "r"(priority) : "memory");
}

void hapsim_port_hold_tick(void) {
    keep_out(TICK_PRIORITY);
}

void hapsim_port_let_tick(void) {
    keep_out(0);
}

uint32_t hapsim_port_now(void) {
    return ~TIMER0->value;
}

void hapsim_port_begin(void) {
    SYSTICK->value = 0;
    INTERRUPT_CONTROL = SYSTICK_PENDING_CLEAR;
    simulated_mass_flick(&mass);
}

uint8_t hapsim_port_measure(int32_t *counts, bool velocity) {
    const bool fits = simulated_mass_position(&mass, &counts[0]);
    if (velocity) {
        counts[1] = simulated_mass_velocity(&mass);
    }
    return fits ? HAPSIM_NO_FAULT : HAPSIM_POSITION_OUT_OF_RANGE;
}

static void in_hexadecimal(char *text, uint32_t word) {
    for (int i = 7; i >= 0; i--, word >>= 4) {
        text[i] = "0123456789abcdef"[word & 15u];
    }
}

/* The whole line in one call. */
static void note_force(void) {
    static char line[] = "00000000 00000000\n";
    in_hexadecimal(line, ticks * TICK_US);
    in_hexadecimal(line + 9, (uint32_t)force);
    register uint32_t write_text __asm("r0") = 4;
    register const char *text __asm("r1") = line;
    __asm volatile("bkpt 0xab" : "+r"(write_text) : "r"(text) : "memory");
}

void hapsim_port_put_forces(const int32_t *counts) {
    force = counts[0];
    note_force();
}

/* Called by the tick, or while the tick is held off. The receiver's priority is the transmitter's too, so it is kept out
 * while the first byte goes. */
bool hapsim_port_write(const uint8_t *bytes, size_t count) {
    uint32_t end = to_send.end;
    if (count > RING - (end - to_send.start)) {
        return false;
    }
    for (size_t i = 0; i < count; i++) {
        to_send.bytes[end++ % RING] = bytes[i];
    }
    uint32_t before;
    __asm volatile("mrs %0, basepri" : "=r"(before));
    keep_out(BYTES_PRIORITY);
    to_send.end = end;
    send_next();
    keep_out(before);
    return true;
}

void hapsim_port_feed_watchdog(void) {
    WATCHDOG_LOCK = WATCHDOG_KEY;
    WATCHDOG->clear = 1;
    WATCHDOG_LOCK = 0;
}

static void start_hardware(void) {
    UART0->divider = 16;
    UART0->control = UART_SENDS | UART_RECEIVES | UART_SENT_INTERRUPTS | UART_INTERRUPTS;
    TIMER0->reload = 0xffffffffu;
    TIMER0->value = 0xffffffffu;
    TIMER0->control = 1;
    INTERRUPT_PRIORITY[0] = BYTES_PRIORITY;
    INTERRUPT_PRIORITY[1] = BYTES_PRIORITY;
    SYSTICK_PRIORITY = TICK_PRIORITY;
    TIMER1->reload = HAPSIM_BOARD_PERIOD_TICKS / 2;
    INTERRUPT_PRIORITY[9] = TICK_PRIORITY;
    INTERRUPT_ENABLE = 1u << 0 | 1u << 1 | 1u << 9;
    SYSTICK->reload = HAPSIM_BOARD_PERIOD_TICKS - 1;
    SYSTICK->value = 0;
    SYSTICK->control = 7; /* counts cycles, interrupts */
    WATCHDOG_LOCK = WATCHDOG_KEY;
    WATCHDOG->load = WATCHDOG_PERIODS * HAPSIM_BOARD_PERIOD_TICKS;
    WATCHDOG->control = 3; /* warns, and resets if the warning is not answered */
    WATCHDOG_LOCK = 0;
}

static bool take_byte(void) {
    const uint32_t end = received.end;
    if (end - received.start > RING) { /* it ran over: the oldest half goes, before the rest is overwritten too */
        received.start = end - RING / 2;
        hapsim_device_lost_bytes();
    }
    if (received.start == end) {
        return false;
    }
    const uint8_t byte = received.bytes[received.start % RING];
    received.start++;
    hapsim_device_take_byte(byte);
    return true;
}

/* Sleeps until the next interrupt, unless a byte came after it was looked for. */
static void rest(void) {
    __asm volatile("cpsid i" : : : "memory");
    if (received.start == received.end) {
        __asm volatile("wfi" : : : "memory");
    }
    __asm volatile("cpsie i" : : : "memory");
}

int main(void) {
    start_hardware();
    note_force(); /* zero, as it came out of the reset */
    hapsim_device_init();
    for (;;) {
        while (take_byte()) {
        }
        TIMER1->control = hapsim_device_look() ? 9 : 0; /* counts, interrupts */
        rest();
#ifdef HAPSIM_BROKEN_TICK /* half a second after arming the tick dies: the hardware watchdog has to see it */
        if (hapsim_device_register(HAPSIM_REG_ACCEPTED) > 500) {
            SYSTICK->control = 0;
        }
#endif
    }
}
