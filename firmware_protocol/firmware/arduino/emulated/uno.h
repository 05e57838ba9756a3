/* SPDX-License-Identifier: MIT */
/* The pins of the emulated Uno that runs the sketch with a potentiometer on A0, PWM on D9 and a direction on D8, for
 * analogue/plant.c. The constants of the sketch come from the build. */
#define HAPSIM_BOARD_CHANNELS 1
#define HAPSIM_BAUD 115200ul
#define RATE 250
#define COMPARE_1A 0x88 /* the low byte of OCR1A: the timer counts 8 bits */
#define MOTORS {MOTOR(1, A, B, 1, B, 0)}
#define SENSORS {0}
#define TWO_INPUTS 0
#define FORWARD_HIGH 1
#define DUTY_IS_ROOT 0

/* The emulated device, in rad and N m. All values are guesses. */
#define COUNT_M (5.2 / 1023) /* rad per count of the converter */
#define PLANT_MASS 2e-5
#define PLANT_FRICTION 5e-5
#define PLANT_EMF 1.25e-4
#define PLANT_COULOMB 0
#define PLANT_FULL 0.05
#define PLANT_NOISE 0.5
