/* SPDX-License-Identifier: MIT */
/* A motor fader of 100 mm with a linear potentiometer between 0 and 5 V. Position 0 is the middle. */
#define DUTY_IS_ROOT 0
#define NEWTONS_PER_COUNT HAPSIM_F64(0x3f700000, 0x00000000) /* 1/256 N: a guess of 1 N at full duty */
#define FORCE_LIMIT HAPSIM_F64(0x3fefe000, 0x00000000)       /* 255/256 N */
#define FORCE_LIMIT_COUNTS 255

#define PRESCALER 5 /* of the converter's clock, as a power of two: 500 kHz, 26 us a conversion */
#define CONVERSIONS 4
#define METRES_PER_COUNT HAPSIM_F64(0x3ef9a001, 0x9a0019a0) /* 100 mm / 4092 */
#define LOWEST 12 /* of 4092: below it, a wire is off. If your fader reaches it, put 100 ohm at each end */
#define HIGHEST 4080
#define FASTEST 400 /* counts from one sample to the next: 9.8 m/s at 1 kHz */

#define TOUCH_STAYS (RATE / 50) /* samples: a period of the mains */

/* The emulated device. All values are guesses. */
#define COUNT_M (0.1 / 1023) /* m per count of the converter */
#define PLANT_MASS 0.05
#define PLANT_FRICTION 0.2
#define PLANT_EMF 0.3
#define PLANT_COULOMB 0.05
#define PLANT_FULL 1.0
#define PLANT_NOISE 0.5
#define PLANT_PAD 20e-12 /* F, of a touch pad and its wire */
#define PLANT_FINGER 150e-12
