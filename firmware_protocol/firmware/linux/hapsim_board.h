/* SPDX-License-Identifier: MIT */
#ifndef HAPSIM_BOARD_H
#define HAPSIM_BOARD_H

#include "../simulated/simulated_board.h"

#define HAPSIM_BOARD_NAME "hapsim linux"
#define HAPSIM_BOARD_PERIOD_TICKS 1000000ul /* the clock counts nanoseconds */

#endif
