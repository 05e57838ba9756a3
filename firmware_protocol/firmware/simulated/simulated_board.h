/* SPDX-License-Identifier: MIT */
/* The common constants of the three emulated boards; each board adds its clock. For your own board, write one file with
 * all of them. */
#define HAPSIM_BOARD_CHANNELS 1
#define HAPSIM_BOARD_PACINGS 3 /* by the device, by the host */
#define HAPSIM_BOARD_MAX_WATCHDOG 2047
#define HAPSIM_BOARD_ROTARY 0                                /* bit c: channel c turns, in rad and N m; 0: not declared */
#define HAPSIM_BOARD_IMPULSE 0                               /* 1: the actuator gives each force once and holds none */
#if defined SIMULATED_SLOW /* for a slow wire: samples of 4 ms, local periods as before */
#define SIMULATED_MS 4
#define HAPSIM_BOARD_RATE HAPSIM_F64(0x406f4000, 0x00000000) /* 250 Hz */
#else
#define SIMULATED_MS 1
#define HAPSIM_BOARD_RATE HAPSIM_F64(0x408f4000, 0x00000000) /* 1000 Hz */
#endif

/* One entry per channel. */
#define HAPSIM_BOARD_POSITION_SCALE {HAPSIM_F64(0x3e112e0b, 0xe826d695)} /* 1e-9 m per count */
#define HAPSIM_BOARD_VELOCITY_SCALE {HAPSIM_F64(0x3e45798e, 0xe2308c3a)} /* 1e-8 m/s per count; zeros: none sensed */
#define HAPSIM_BOARD_FORCE_LIMIT {HAPSIM_F64(0x40240000, 0x00000000)}    /* 10 N, */
#ifndef SIMULATED_STEPS
#define HAPSIM_BOARD_FORCE_SCALE {HAPSIM_F64(0x3e45798e, 0xe2308c3a)}    /* 1e-8 N per count */
#define HAPSIM_BOARD_FORCE_LIMIT_COUNTS {1000000000}                     /* the same in counts, rounded down */
#else
/* The board follows lines, with SIMULATED_STEPS local periods in a millisecond. A line's force may lie beyond the limit, so
 * its counts reach 2147 N. A shift of 8 makes 1000 N/m (force scale / position scale) 3.90625 N/m per count of
 * stiffness; one of 9 makes 1 N s/m (that times the window, one sample) 1/512 N s/m per count of damping. The largest
 * are those of PROTOCOL.md, section 6.1, for 0.2 kg and 1 N s/m: k with 10 N s/m more, b with a margin of four. */
#define HAPSIM_BOARD_STEPS (SIMULATED_STEPS * SIMULATED_MS)
#define HAPSIM_BOARD_FORCE_SCALE {HAPSIM_F64(0x3eb0c6f7, 0xa0b5ed8d)}    /* 1e-6 N per count */
#define HAPSIM_BOARD_FORCE_LIMIT_COUNTS {10000000}
#define HAPSIM_BOARD_LINE_SHIFTS {{8, 9}}
#if SIMULATED_STEPS == 10
#define HAPSIM_BOARD_LARGEST {{18773, 39384}} /* 73.3 kN/m, 76.9 N s/m */
#elif SIMULATED_MS == 4
#define HAPSIM_BOARD_LARGEST {{9386, 2782}} /* 36.7 kN/m, 21.7 N s/m */
#elif SIMULATED_STEPS == 5
#define HAPSIM_BOARD_LARGEST {{9386, 32000}} /* 36.7 kN/m, 62.5 N s/m */
#endif
#endif
