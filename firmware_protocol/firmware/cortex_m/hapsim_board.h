/* SPDX-License-Identifier: MIT */
#ifndef HAPSIM_BOARD_H
#define HAPSIM_BOARD_H

#include "../simulated/simulated_board.h"

#define HAPSIM_BOARD_NAME "hapsim cortex-m"
#define HAPSIM_BOARD_DIGITAL_WORD 1 /* two LEDs are outputs, and read back; two buttons are inputs 8 and 9 */
#define HAPSIM_BOARD_PERIOD_TICKS 25000ul /* the clock counts at 25 MHz */

#endif
