/* SPDX-License-Identifier: MIT */
/* A motor and a position sensor as a device of hapsim. Set these constants for your wiring; nothing else has to change.
 * The library's README.md has the wiring and the first steps. */

#define SENSOR ENCODER           /* ENCODER: quadrature; AS5600: magnetic, I2C; POTENTIOMETER */
#define SENSOR_PIN_A 2           /* encoder: A, with interrupt; potentiometer: wiper, such as A0; AS5600: unused */
#define SENSOR_PIN_B 3           /* encoder: B, with interrupt; else unused */
#define DRIVER PWM_AND_DIRECTION /* or TWO_PWMS: one input for each direction */
#define MOTOR_PIN_A 9            /* PWM; with TWO_PWMS: the input for positive forces */
#define MOTOR_PIN_B 8            /* direction, high for positive forces; with TWO_PWMS: the input for negative forces */
#define ENABLE_PIN NO_PIN        /* the driver's enable or sleep input: high while the device is armed */

#define MOTION ROTARY            /* ROTARY: rad, N m; LINEAR: m, N */
#define COUNTS 2400              /* over TRAVEL: encoder 4 a line; AS5600 4096; potentiometer 1023 (ESP32: 4095) */
#define TRAVEL 6.283185307       /* rad: a turn; a potentiometer's angle or, in m, its stroke */
#define POSITION_SIGN 1          /* 1 or -1: the direction of larger positions */
#define FORCE_SIGN 1             /* 1 or -1: a positive force must push towards larger positions */
#define FULL_FORCE 0.05          /* N m or N, at full duty and standstill */
#define FORCE_LIMIT 0.02         /* N m or N, at most FULL_FORCE; a tenth of that is careful for a first start */

#define HOST_PORT Serial
#define BAUD_RATE 115200         /* a port of native USB ignores it: then write 2000000 */
#define RATE_HZ 250              /* 500 at 250000 baud, 1000 at 500000 baud or by USB */

#define PWM_TOP 255              /* the duty for FULL_FORCE */
#define PWM_SETUP                /* AVR: none needed. Teensy, ESP32: analogWriteFrequency(MOTOR_PIN_A, 20000), and with
                                    TWO_PWMS the same for MOTOR_PIN_B; STM32: analogWriteFrequency(20000);
                                    RP2040: analogWriteFreq(20000) */

#include <hapsim_motor.h>

void setup() {
    hapsim_motor_begin();
}

void loop() {
    hapsim_motor_loop();
}
