/* SPDX-License-Identifier: MIT */
/* The common constants of the three emulated boards; each board adds its clock. For your own board, write one file with
 * all of them. */
#define HAPSIM_BOARD_CHANNELS 1
#define HAPSIM_BOARD_PACINGS 3 /* by the device, by the host */
#define HAPSIM_BOARD_MAX_WATCHDOG 2047
#define HAPSIM_BOARD_ROTARY 0                                /* bit c: channel c turns, in rad and N m; 0: not declared */
#define HAPSIM_BOARD_IMPULSE 0                               /* 1: the actuator gives each force once and holds none */
#define HAPSIM_BOARD_RATE HAPSIM_F64(0x408f4000, 0x00000000) /* 1000 Hz */

/* One entry per channel. */
#define HAPSIM_BOARD_POSITION_SCALE {HAPSIM_F64(0x3e112e0b, 0xe826d695)} /* 1e-9 m per count */
#define HAPSIM_BOARD_VELOCITY_SCALE {HAPSIM_F64(0x3e45798e, 0xe2308c3a)} /* 1e-8 m/s per count; zeros: none sensed */
#define HAPSIM_BOARD_FORCE_SCALE {HAPSIM_F64(0x3e45798e, 0xe2308c3a)}    /* 1e-8 N per count */
#define HAPSIM_BOARD_FORCE_LIMIT {HAPSIM_F64(0x40240000, 0x00000000)}    /* 10 N, */
#define HAPSIM_BOARD_FORCE_LIMIT_COUNTS {1000000000}                     /* the same in counts, rounded down */
