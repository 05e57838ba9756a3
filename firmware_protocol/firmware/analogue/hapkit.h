/* SPDX-License-Identifier: MIT */
/* A Hapkit (haphub.github.io): PWM on D5, direction on D8, magneto-resistive sensor on A2. Pins and figures come from
 * the courses' programs (helpers.h, haphub/hAPI). For your own kit, measure them as PORTING.md describes. */
#define HAPSIM_BOARD_NAME "hapsim hapkit"
#define HAPSIM_BOARD_CHANNELS 1

#ifndef HAPSIM_BAUD
#define HAPSIM_BAUD 500000ul /* 115200 on a genuine Uno, see PORTING.md */
#endif
#ifndef RATE
#define RATE (HAPSIM_BAUD < 250000 ? 400 : 1000)
#endif
#define HAPSIM_BOARD_ROTARY 0

/* Timer 0 B (D5) drives the bridge's enable pin. Port B 0 (D8) drives its direction, which is high for a positive
 * force. The torque is 0.0183 N m times the square of the duty; full duty gives 4.26 N at the handle. A count is a
 * 65536th of that force, so the root of the counts is the duty in 256ths. */
#define MOTORS {MOTOR(0, B, D, 5, B, 0)}
#define TWO_INPUTS 0
#define FORWARD_HIGH 1
#define DUTY_IS_ROOT 1
#define NEWTONS_PER_COUNT HAPSIM_F64(0x3f110a13, 0x7f38c543) /* 6.5e-5 N */
#define FORCE_LIMIT HAPSIM_F64(0x4010e810, 0x624dd2f1)       /* 4.226625 N: a duty of 255 */
#define FORCE_LIMIT_COUNTS 65025

/* The sensor repeats itself every half turn of the motor, or 13.5 mm at the handle. That is 787 counts; a count is
 * 0.0131 degrees of the sector, 17.2 um at the handle. */
#define SENSORS {2}
#define PRESCALER 7 /* of the converter's clock, as a power of two: 125 kHz, 104 us a conversion */
#define CONVERSIONS 1
#define METRES_PER_COUNT HAPSIM_F64(0x3ef20916, 0xfff6c5c5) /* 17.2e-6 m */
#define TOOTH 787
#define LOWEST 60 /* outside of LOWEST to HIGHEST the sensor's wire is off */
#define HIGHEST 963
#define FASTEST 190 /* counts from one sample to the next; a step of half a tooth would have no clear direction */

/* The emulated device. Sensor and torque are those above; mass, friction, noise and motor are guesses. */
#define COUNT_M 17.2e-6 /* m per count of the converter */
#define SENSOR_LEAST 118
#define PLANT_MASS 0.1
#define PLANT_FRICTION 0.1
#define PLANT_EMF 0.4
#define PLANT_COULOMB 0.05
#define PLANT_FULL 4.25984
#define PLANT_NOISE 0.5
