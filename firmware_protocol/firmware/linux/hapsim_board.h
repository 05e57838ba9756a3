/* SPDX-License-Identifier: MIT */
#ifndef HAPSIM_BOARD_H
#define HAPSIM_BOARD_H

#include "../simulated/simulated_board.h"

#define HAPSIM_BOARD_NAME "hapsim linux"
#define HAPSIM_BOARD_DIGITAL_WORD 1
#define HAPSIM_BOARD_PERIOD_TICKS 1000000ul /* the clock counts nanoseconds */
#define HAPSIM_BOARD_ACCELERATION_SCALE {HAPSIM_F64(0x3e6ad7f2, 0x9abcaf48)} /* 5e-8 m/s^2 per count */

#endif
