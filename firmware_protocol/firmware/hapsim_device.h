/* SPDX-License-Identifier: MIT */
/* The state machine of a force-feedback device (PROTOCOL.md, sections 4 to 8). It connects the bytes of the host to the
 * board's functions (hapsim_port.h). C99, integers only; it neither allocates nor waits.
 *
 *     main:  hapsim_device_init();
 *            for (;;) {
 *                while (a byte has come) hapsim_device_take_byte(byte);
 *                hapsim_device_look();
 *            }
 *     the sample timer's interrupt, at the rate in register 4, from power-up on:
 *            hapsim_device_tick();
 *
 * A board that follows lines (HAPSIM_BOARD_STEPS) has a faster timer instead, that many times per sample:
 *            if (hapsim_device_step()) run hapsim_device_tick() next, where the step may interrupt it;
 */
#ifndef HAPSIM_DEVICE_H
#define HAPSIM_DEVICE_H

#include "../hapsim_protocol.h"

/* An IEEE 754 double as two words, for scales, limits and the rate in hapsim_board.h. The words are hexadecimal: the
 * double of some compilers (avr-gcc) has 4 bytes. PORTING.md has a table of common values. In Python,
 * `struct.pack('>d', 1e-9).hex(' ', -4)` prints both words. */
typedef struct {
    uint32_t low, high;
} hapsim_f64;

/* A word written as a floating-point number is a compile error here. The long name of the field gives the reason. */
#define HAPSIM_IS_WHOLE(word) (((word) * 0 + 1) / 2 == 0)
#define HAPSIM_HALF(word)                                                                                             \
    ((uint32_t)(word) +                                                                                               \
     0u * (uint32_t)sizeof(struct {                                                                                   \
         int a_double_may_have_4_bytes_here_so_write_its_two_hex_words_see_PORTING : HAPSIM_IS_WHOLE(word) ? 1 : -1; \
     }))
#define HAPSIM_F64(high_word, low_word) {HAPSIM_HALF(low_word), HAPSIM_HALF(high_word)}

/* Sets the device idle with zero force. Call it at power-up. */
void hapsim_device_init(void);

/* Processes a byte of the host. Call it from the main loop. */
void hapsim_device_take_byte(uint8_t byte);

/* Discards the beginning of an unfinished frame, because bytes of the host were lost before the next one. Call it from
 * the main loop. */
void hapsim_device_lost_bytes(void);

/* Ends a sample period. Call it from the sample timer in every state and with every pacing: it feeds the hardware
 * watchdog. */
void hapsim_device_tick(void);

/* Begins a local period of a board that follows lines: puts out a force, measures, computes the next force. May interrupt
 * the tick and the main loop, and must not be interrupted by them. Returns true if hapsim_device_tick is due. */
bool hapsim_device_step(void);

/* If the host paces, checks that the host has not been quiet for too long. Call this in every round of the main loop.
 * Returns true if the host paces: the next call should then come soon. The tick makes the same check up to a period
 * later. */
bool hapsim_device_look(void);

/* Returns HAPSIM_IDLE, HAPSIM_ARMED or HAPSIM_LATCHED, for a lamp. */
uint8_t hapsim_device_state(void);

/* Returns the value with which DESCRIBE is answered. Call it from the main loop. */
uint32_t hapsim_device_register(uint16_t number);

#endif
