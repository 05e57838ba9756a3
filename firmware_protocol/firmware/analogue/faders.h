/* SPDX-License-Identifier: MIT */
/* Motor faders; FADERS is their number (1, 2 or 4). They are wired as in tttapa/Control-Surface-Motor-Fader (main.cpp).
 * Each fader has two inputs of an L293D: one for PWM (D3, D11, D5, D6), one for the direction (D2, D13, D4, D7). The
 * potentiometers are on A0 to A3. Force and travel are guesses. */
#define HAPSIM_BOARD_NAME "hapsim faders"
#define HAPSIM_BOARD_CHANNELS FADERS

#ifndef HAPSIM_BAUD
#define HAPSIM_BAUD 1000000ul
#endif
#ifdef RATE
#elif HAPSIM_BAUD < 500000
#define RATE (HAPSIM_BOARD_CHANNELS > 2 ? 160 : HAPSIM_BOARD_CHANNELS > 1 ? 250 : 400)
#else
#define RATE (HAPSIM_BOARD_CHANNELS > 2 ? 500 : 1000)
#endif
#define HAPSIM_BOARD_ROTARY 0

/* Touch pads on D8, D9, D10 and D12, each with a resistor to the supply: 1 Mohm or less, so that the pad alone is charged
 * within a conversion, 26 us, and with a finger is not. */
#if HAPSIM_BOARD_CHANNELS == 1
#define TOUCHES {TOUCH(B, 0)}
#define MOTORS {MOTOR(2, B, D, 3, D, 2)}
#define SENSORS {0}
#elif HAPSIM_BOARD_CHANNELS == 2
#define TOUCHES {TOUCH(B, 0), TOUCH(B, 1)}
#define MOTORS {MOTOR(2, B, D, 3, D, 2), MOTOR(2, A, B, 3, B, 5)}
#define SENSORS {0, 1}
#else
#define TOUCHES {TOUCH(B, 0), TOUCH(B, 1), TOUCH(B, 2), TOUCH(B, 4)}
#define MOTORS {MOTOR(2, B, D, 3, D, 2), MOTOR(2, A, B, 3, B, 5), MOTOR(0, B, D, 5, D, 4), MOTOR(0, A, D, 6, D, 7)}
#define SENSORS {0, 1, 2, 3}
#endif
#define TWO_INPUTS 1 /* the bridge has two: while the direction is high, PWM is inverted */
#define FORWARD_HIGH 0
#include "potentiometer.h"
