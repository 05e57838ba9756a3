/* SPDX-License-Identifier: MIT */
/* Haply's pantograph behind the bridge: x and y of its end point. */
#ifndef HAPSIM_BOARD_H
#define HAPSIM_BOARD_H

#define HAPSIM_BOARD_NAME "haply bridge"
#define HAPSIM_BOARD_PERIOD_TICKS 1000000ul /* the clock counts nanoseconds */
#define HAPSIM_BOARD_CHANNELS 2
#define HAPSIM_BOARD_PACINGS 3 /* by the bridge's clock, by the host (better, see README.md) */
#define HAPSIM_BOARD_MAX_WATCHDOG 2047
#define HAPSIM_BOARD_IMPULSE 0
#define HAPSIM_BOARD_BRIDGE 1 /* the motors are behind another protocol: hapsim's guarantees end at this process */
#define HAPSIM_BOARD_RATE HAPSIM_F64(0x408f4000, 0x00000000) /* 1000 Hz */

/* hAPI's angles are f32 degrees, 24 nm at the end point; the encoders' counts are 40 to 90 um. */
#define HAPSIM_BOARD_100_NM HAPSIM_F64(0x3e7ad7f2, 0x9abcaf48) /* 1e-7 m per count */
#define HAPSIM_BOARD_10_NN HAPSIM_F64(0x3e45798e, 0xe2308c3a)  /* 1e-8 N per count */
#define HAPSIM_BOARD_5_N HAPSIM_F64(0x40140000, 0x00000000)    /* more than the motors give in most poses */
#define HAPSIM_BOARD_NONE HAPSIM_F64(0, 0)

#define HAPSIM_BOARD_POSITION_SCALE {HAPSIM_BOARD_100_NM, HAPSIM_BOARD_100_NM}
#define HAPSIM_BOARD_VELOCITY_SCALE {HAPSIM_BOARD_NONE, HAPSIM_BOARD_NONE}
#define HAPSIM_BOARD_FORCE_SCALE {HAPSIM_BOARD_10_NN, HAPSIM_BOARD_10_NN}
#define HAPSIM_BOARD_FORCE_LIMIT {HAPSIM_BOARD_5_N, HAPSIM_BOARD_5_N}
#define HAPSIM_BOARD_FORCE_LIMIT_COUNTS {500000000, 500000000}

#endif
