/* The harness as a board: what a session of sessions.json says of its device comes as -D from the test. */
#ifndef HAPSIM_BOARD_H
#define HAPSIM_BOARD_H

#define HAPSIM_BOARD_NAME "harness"
#define HAPSIM_BOARD_CHANNELS HARNESS_CHANNELS
#define HAPSIM_BOARD_PACINGS HARNESS_PACINGS
#define HAPSIM_BOARD_MAX_WATCHDOG HARNESS_MAX_WATCHDOG
#define HAPSIM_BOARD_IMPULSE HARNESS_IMPULSE
#define HAPSIM_BOARD_PERIOD_TICKS 1000ul /* the clock counts thousandths of a period */
#define HAPSIM_BOARD_RATE HAPSIM_F64(0x408f4000, 0x00000000) /* 1000 Hz */

#define EACH(value) {value, value, value, value}
#if HARNESS_CHANNELS == 1
#undef EACH
#define EACH(value) {value}
#endif
#define NANO HAPSIM_F64(0x3e112e0b, 0xe826d695)      /* 1e-9 */
#define TEN_NANO HAPSIM_F64(0x3e45798e, 0xe2308c3a)  /* 1e-8 */
#define TEN HAPSIM_F64(0x40240000, 0x00000000)
#define NONE HAPSIM_F64(0, 0)
#define HAPSIM_BOARD_POSITION_SCALE EACH(NANO)
#define HAPSIM_BOARD_FORCE_SCALE EACH(TEN_NANO)
#define HAPSIM_BOARD_FORCE_LIMIT EACH(TEN)
#define HAPSIM_BOARD_FORCE_LIMIT_COUNTS EACH(1000000000)
#if HARNESS_VELOCITY
#define HAPSIM_BOARD_VELOCITY_SCALE EACH(TEN_NANO)
#else
#define HAPSIM_BOARD_VELOCITY_SCALE EACH(NONE)
#endif

#define HAPSIM_KNOB_TURN 16384
#define HAPSIM_KNOB_NM_PER_COUNT 1.0f
#ifndef HAPSIM_KNOB_LARGEST_STEP
#define HAPSIM_KNOB_LARGEST_STEP (1ll << 60) /* sessions place it anywhere */
#endif
#define HAPSIM_KNOB_TIMER TIM6

#endif
