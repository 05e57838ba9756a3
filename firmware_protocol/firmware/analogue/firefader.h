/* SPDX-License-Identifier: MIT */
/* A FireFader on an Arduino Nano: PWM on D5 and D6, direction on D4 and D7, potentiometers on A2 and A3, touch pads
 * on D9 and D2 with 1 Mohm to the supply. The pins come from its own program (eberdahl/Open-Source-Haptics-For-Artists, haptics_firmware.ino). Force and travel are
 * guesses. */
#define HAPSIM_BOARD_NAME "hapsim firefader"
#define HAPSIM_BOARD_CHANNELS 2

#ifndef HAPSIM_BAUD
#define HAPSIM_BAUD 1000000ul
#endif
#ifndef RATE
#define RATE (HAPSIM_BAUD < 500000 ? 250 : 1000)
#endif
#define HAPSIM_BOARD_ROTARY 0

#define MOTORS {MOTOR(0, B, D, 5, D, 4), MOTOR(0, A, D, 6, D, 7)}
#define TOUCHES {TOUCH(B, 1), TOUCH(D, 2)}
#define TWO_INPUTS 0
#define FORWARD_HIGH 0
#include "potentiometer.h"
#define SENSORS {2, 3}
