/* SPDX-License-Identifier: MIT */
/* A servo with a force sensor in its handle, for admittance: 50 Hz, critically damped; 1 m/s, 20 m/s^2, 100 N. */
#ifndef HAPSIM_BOARD_H
#define HAPSIM_BOARD_H

#define HAPSIM_BOARD_NAME "hapsim servo"
#define HAPSIM_BOARD_CHANNELS 1
#define HAPSIM_BOARD_PACINGS 1 /* by the device: a servo's commands need its clock */
#define HAPSIM_BOARD_MAX_WATCHDOG 2047
#define HAPSIM_BOARD_IMPULSE 0
#define HAPSIM_BOARD_PERIOD_TICKS 1000000ul                  /* the clock counts nanoseconds */
#define HAPSIM_BOARD_RATE HAPSIM_F64(0x408f4000, 0x00000000) /* 1000 Hz */

#define HAPSIM_BOARD_POSITION_SCALE {HAPSIM_F64(0x3e112e0b, 0xe826d695)} /* 1e-9 m per count */
#define HAPSIM_BOARD_VELOCITY_SCALE {HAPSIM_F64(0, 0)}                   /* none sensed */
#define HAPSIM_BOARD_FORCE_SCALE {HAPSIM_F64(0x3e45798e, 0xe2308c3a)}    /* 1e-8 N per count, of a motor that gives */
#define HAPSIM_BOARD_FORCE_LIMIT {HAPSIM_F64(0x40240000, 0x00000000)}    /* 10 N where the host asks for forces; */
#define HAPSIM_BOARD_FORCE_LIMIT_COUNTS {1000000000}                     /* this one gives none */

#define HAPSIM_BOARD_HAND_FORCE_SCALE {HAPSIM_F64(0x3eb0c6f7, 0xa0b5ed8d)} /* 1e-6 N per count */
#define HAPSIM_BOARD_HAND_FORCE_RANGE {HAPSIM_F64(0x40590000, 0x00000000)} /* 100 N */
#define HAPSIM_BOARD_SPEED_LIMIT {HAPSIM_F64(0x3ff00000, 0x00000000)}      /* 1 m/s */
#define HAPSIM_BOARD_SPEED_LIMIT_COUNTS {1000000}                          /* the same in counts per sample */
#define HAPSIM_BOARD_BRAKING {HAPSIM_F64(0x40340000, 0x00000000)}          /* 20 m/s^2 */
#define HAPSIM_BOARD_BRAKING_COUNTS {5120000}                              /* in 2^-8 counts per sample, each sample */
#define HAPSIM_BOARD_BANDWIDTH {HAPSIM_F64(0x40490000, 0x00000000)}        /* 50 Hz */
#define HAPSIM_BOARD_SERVO_DAMPING {HAPSIM_F64(0x3ff00000, 0x00000000)}    /* 1 */
#define HAPSIM_BOARD_HOLD_SAMPLES 500                                      /* 0.5 s */

#endif
