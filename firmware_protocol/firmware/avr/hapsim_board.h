/* SPDX-License-Identifier: MIT */
#ifndef HAPSIM_BOARD_H
#define HAPSIM_BOARD_H

#include "../simulated/simulated_board.h"

#define HAPSIM_BOARD_NAME "hapsim avr"
#ifndef HAPSIM_BAUD
#define HAPSIM_BAUD 2000000ul
#endif
#define HAPSIM_BOARD_PERIOD_TICKS 2000ul /* the clock counts half microseconds: timer 1 behind its prescaler of 8 */

#endif
