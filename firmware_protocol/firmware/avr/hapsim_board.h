/* SPDX-License-Identifier: MIT */
#ifndef HAPSIM_BOARD_H
#define HAPSIM_BOARD_H

#include "../simulated/simulated_board.h"

#define HAPSIM_BOARD_KEPT 16
#ifndef HAPSIM_BOARD_STEPS
#define HAPSIM_BOARD_DIGITAL_WORD 1 /* D8 to D13 are outputs, and read back; A0 to A5 are inputs 8 to 13 */
#endif
#define HAPSIM_BOARD_NAME "hapsim avr"
#ifndef HAPSIM_BAUD
#define HAPSIM_BAUD 2000000ul
#endif
#define HAPSIM_BOARD_PERIOD_TICKS (2000ul * SIMULATED_MS) /* the clock is timer 1 with prescaler 8: half microseconds */

#endif
