/* SPDX-License-Identifier: MIT */
/* The registers in use of ARM's MPS2 board with the AN385 image (Cortex-M3, 25 MHz). They belong to a UART, two timers
 * and a watchdog of the CMSDK, and to the processor's own timer. QEMU emulates the board: qemu-system-arm -M
 * mps2-an385. */
#ifndef MPS2_H
#define MPS2_H

#include <stdint.h>

typedef volatile uint32_t reg;

typedef struct {
    reg data, state, control, interrupts, divider;
} uart_registers;
#define UART0 ((uart_registers *)0x40004000u)
enum { UART_TRANSMITTER_FULL = 1, UART_RECEIVER_FULL = 2 };                            /* state */
enum { UART_SENDS = 1, UART_RECEIVES = 2, UART_SENT_INTERRUPTS = 4, UART_INTERRUPTS = 8 }; /* control */
enum { UART_SENT = 1, UART_RECEIVED = 2 };                                             /* interrupts */

typedef struct {
    reg control, value, reload, interrupts;
} timer_registers;
#define TIMER0 ((timer_registers *)0x40000000u)
#define TIMER1 ((timer_registers *)0x40001000u)

#define LEDS (*(reg *)0x40028000u)
#define BUTTONS (*(reg *)0x40028008u)

typedef struct {
    reg load, value, control, clear;
} watchdog_registers;
#define WATCHDOG ((watchdog_registers *)0x40008000u)
#define WATCHDOG_LOCK (*(reg *)0x40008c00u)
#define WATCHDOG_KEY 0x1acce551u

typedef struct {
    reg control, reload, value;
} systick_registers;
#define SYSTICK ((systick_registers *)0xe000e010u)
#define INTERRUPT_ENABLE (*(reg *)0xe000e100u)
#define INTERRUPT_CONTROL (*(reg *)0xe000ed04u)
#define SYSTICK_PENDING_CLEAR (1u << 25)
#define PENDSV_PENDING_SET (1u << 28)
#define PENDSV_PRIORITY (*(volatile uint8_t *)0xe000ed22u)
#define SYSTICK_PRIORITY (*(volatile uint8_t *)0xe000ed23u)
#define INTERRUPT_PRIORITY ((volatile uint8_t *)0xe000e400u)

#endif
