/* SPDX-License-Identifier: MIT */
/* A force-feedback device of hapsim: the state machine of PROTOCOL.md, sections 4 to 8, between the bytes of the host and
 * the board's few functions (hapsim_port.h). C99, integers, no allocation, nothing that waits.
 *
 *     main:  hapsim_device_init();
 *            for (;;) {
 *                while (a byte has come) hapsim_device_take_byte(byte);
 *                hapsim_device_look();
 *            }
 *     the sample timer's interrupt, at the rate in register 4, from power-up on:
 *            hapsim_device_tick();
 */
#ifndef HAPSIM_DEVICE_H
#define HAPSIM_DEVICE_H

#include "../hapsim_protocol.h"

/* An IEEE 754 double as two words: for scales, limits and the rate in hapsim_board.h. Written in hexadecimal, because the
 * double of some compilers (avr-gcc) has 4 bytes. PORTING.md has a table of the usual ones; in Python
 * `struct.pack('>d', 1e-9).hex(' ', -4)` prints both. */
typedef struct {
    uint32_t low, high;
} hapsim_f64;

/* A word that somebody wrote as a floating number stops the compiler here, with a name that says why. */
#define HAPSIM_IS_WHOLE(word) (((word) * 0 + 1) / 2 == 0)
#define HAPSIM_HALF(word)                                                                                             \
    ((uint32_t)(word) +                                                                                               \
     0u * (uint32_t)sizeof(struct {                                                                                   \
         int a_double_may_have_4_bytes_here_so_write_its_two_hex_words_see_PORTING : HAPSIM_IS_WHOLE(word) ? 1 : -1; \
     }))
#define HAPSIM_F64(high_word, low_word) {HAPSIM_HALF(low_word), HAPSIM_HALF(high_word)}

/* At power-up: idle, force zero. */
void hapsim_device_init(void);

/* A byte of the host. From the main loop. */
void hapsim_device_take_byte(uint8_t byte);

/* Bytes of the host were lost before the next one: the beginning of an unfinished frame is forgotten. From the main
 * loop. */
void hapsim_device_lost_bytes(void);

/* One sample period has passed. From the sample timer, in every state and whatever paces: it feeds the hardware
 * watchdog. */
void hapsim_device_tick(void);

/* Paced by the host, whether it has been quiet for too long. From the main loop, as often as it comes round; true where
 * that should be soon, because the host paces. What is not seen here is seen by the tick, up to a period later. */
bool hapsim_device_look(void);

/* HAPSIM_IDLE, HAPSIM_ARMED or HAPSIM_LATCHED: for a lamp. */
uint8_t hapsim_device_state(void);

/* What DESCRIBE answers. From the main loop. */
uint32_t hapsim_device_register(uint16_t number);

#endif
