/* SPDX-License-Identifier: MIT */
/* The constants of a knob. Change them here: the whole library is compiled with them. PORTING.md explains them. */
#ifndef HAPSIM_BOARD_H
#define HAPSIM_BOARD_H

#define HAPSIM_BOARD_NAME "hapsim knob"
#define HAPSIM_BOARD_CHANNELS 1
#define HAPSIM_BOARD_PACINGS 3 /* by the device, by the host */
#define HAPSIM_BOARD_MAX_WATCHDOG 2047
#define HAPSIM_BOARD_ROTARY 1 /* rad, N m */
#define HAPSIM_BOARD_IMPULSE 0
#define HAPSIM_BOARD_RATE HAPSIM_F64(0x408f4000, 0x00000000) /* 1000 Hz */
#define HAPSIM_BOARD_PERIOD_TICKS 1000ul                     /* the clock counts microseconds */

/* Counts per turn, the resolution of an MT6701 or an AS5047. The position scale is 2 pi divided by this number. */
#define HAPSIM_KNOB_TURN 16384
#define HAPSIM_BOARD_POSITION_SCALE {HAPSIM_F64(0x3f3921fb, 0x54442d18)} /* 0.0003834951969714103 rad per count */
#define HAPSIM_BOARD_VELOCITY_SCALE {HAPSIM_F64(0, 0)} /* none sensed: SimpleFOC derives velocities */

#define HAPSIM_KNOB_NM_PER_COUNT 1e-8f
#define HAPSIM_BOARD_FORCE_SCALE {HAPSIM_F64(0x3e45798e, 0xe2308c3a)} /* 1e-8 N m per count: the same */

/* Begin with a tenth of the motor's largest torque. */
#define HAPSIM_BOARD_FORCE_LIMIT {HAPSIM_F64(0x3f847ae1, 0x47ae147b)} /* 0.01 N m, */
#define HAPSIM_BOARD_FORCE_LIMIT_COUNTS {1000000}                     /* the same in counts, rounded down */

/* A larger step of the angle between two rounds of the FOC loop is a fault. No hand and no motor of this kind makes it.
 * A twelfth of a turn is 5000 rpm if a round takes 1 ms, and more if it takes less. */
#define HAPSIM_KNOB_LARGEST_STEP (HAPSIM_KNOB_TURN / 12)

/* STM32: a timer that neither the PWM nor anything else uses. */
#define HAPSIM_KNOB_TIMER TIM6

#endif
