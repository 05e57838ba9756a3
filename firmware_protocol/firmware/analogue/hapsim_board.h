/* SPDX-License-Identifier: MIT */
/* The constants of an analogue board that follow from the constants of its device. HAPSIM_ANALOGUE names the device's
 * header, which the firmware and the emulated device share. */
#ifndef HAPSIM_BOARD_H
#define HAPSIM_BOARD_H

#include HAPSIM_ANALOGUE

#define HAPSIM_BOARD_PACINGS 3 /* by the device, by the host */
#define HAPSIM_BOARD_MAX_WATCHDOG 2047
#define HAPSIM_BOARD_IMPULSE 0
#ifdef TOUCHES
#define HAPSIM_BOARD_DIGITAL_WORD 1
#endif
#define HAPSIM_BOARD_PERIOD_TICKS (2000000ul / RATE) /* the clock is timer 1 with prescaler 8: half microseconds */

/* A whole number of Hz as a double; its low word is zero. */
#if RATE < 128 || RATE > 2047
#error "RATE: 128 to 2047 Hz"
#elif RATE < 256
#define HAPSIM_BOARD_RATE HAPSIM_F64(0x40600000 + ((RATE - 128ul) << 13), 0)
#elif RATE < 512
#define HAPSIM_BOARD_RATE HAPSIM_F64(0x40700000 + ((RATE - 256ul) << 12), 0)
#elif RATE < 1024
#define HAPSIM_BOARD_RATE HAPSIM_F64(0x40800000 + ((RATE - 512ul) << 11), 0)
#else
#define HAPSIM_BOARD_RATE HAPSIM_F64(0x40900000 + ((RATE - 1024ul) << 10), 0)
#endif

/* Bytes of an exchange (PROTOCOL.md, section 11). If they do not fit a sample, every force is late. */
#define EXCHANGE_BYTES (HAPSIM_BOARD_CHANNELS > 3 ? 19ul + 8 * HAPSIM_BOARD_CHANNELS : 15ul + 8 * HAPSIM_BOARD_CHANNELS)
#if EXCHANGE_BYTES * 10 * RATE > HAPSIM_BAUD
#error "HAPSIM_BAUD is too slow for this RATE: an exchange takes longer than a sample"
#endif

/* One entry per channel. */
#if HAPSIM_BOARD_CHANNELS == 1
#define EACH(value) {value}
#elif HAPSIM_BOARD_CHANNELS == 2
#define EACH(value) {value, value}
#else
#define EACH(value) {value, value, value, value}
#endif
#define HAPSIM_BOARD_POSITION_SCALE EACH(METRES_PER_COUNT)
#define HAPSIM_BOARD_VELOCITY_SCALE {{0, 0}}
#define HAPSIM_BOARD_FORCE_SCALE EACH(NEWTONS_PER_COUNT)
#define HAPSIM_BOARD_FORCE_LIMIT EACH(FORCE_LIMIT)
#define HAPSIM_BOARD_FORCE_LIMIT_COUNTS EACH(FORCE_LIMIT_COUNTS)

#endif
