/* SPDX-License-Identifier: MIT */
/* The constants of a board that follow from the sketch's constants, and what the compiler can check of them. */
#ifndef HAPSIM_BOARD_H
#define HAPSIM_BOARD_H

/* The two words of a double above zero, from one that may have 4 bytes (AVR): then exact to 6e-8. */
constexpr int hapsim_exponent(double value) {
    return value >= 2 ? hapsim_exponent(value / 2) + 1 : value < 1 ? hapsim_exponent(value * 2) - 1 : 0;
}
constexpr double hapsim_shifted(double value, int exponent) {
    return exponent > 0   ? hapsim_shifted(value / 2, exponent - 1)
           : exponent < 0 ? hapsim_shifted(value * 2, exponent + 1)
                          : value;
}
constexpr hapsim_f64 hapsim_words(double bits, int exponent) { /* bits: mantissa times 2^20, from 2^20 to 2^21 */
    return {(uint32_t)((bits - (uint32_t)bits) * 4294967296.0),
            (uint32_t)bits - 1048576u + ((uint32_t)(exponent + 1023) << 20)};
}
constexpr hapsim_f64 hapsim_double(double value) {
    return hapsim_words(hapsim_shifted(value, hapsim_exponent(value) - 20), hapsim_exponent(value));
}

#define HAPSIM_FORCE_COUNTS 32768l /* of FULL_FORCE */
#define HAPSIM_BOARD_NAME "hapsim arduino"
#define HAPSIM_BOARD_CHANNELS 1
#define HAPSIM_BOARD_PACINGS 3 /* by the device, by the host */
#define HAPSIM_BOARD_MAX_WATCHDOG 2047
#define HAPSIM_BOARD_ROTARY (MOTION == ROTARY)
#define HAPSIM_BOARD_IMPULSE 0
#define HAPSIM_BOARD_PERIOD_TICKS (1000000 / (RATE_HZ)) /* the clock is micros() */
#define HAPSIM_BOARD_RATE hapsim_double(RATE_HZ)
#define HAPSIM_BOARD_POSITION_SCALE {hapsim_double((double)(TRAVEL) / (COUNTS))}
#define HAPSIM_BOARD_VELOCITY_SCALE {{0, 0}}
#define HAPSIM_BOARD_FORCE_SCALE {hapsim_double((double)(FULL_FORCE) / HAPSIM_FORCE_COUNTS)}
#define HAPSIM_BOARD_FORCE_LIMIT {hapsim_double(FORCE_LIMIT)}
#define HAPSIM_BOARD_FORCE_LIMIT_COUNTS {(int32_t)((double)(FORCE_LIMIT) / (FULL_FORCE) * HAPSIM_FORCE_COUNTS)}

/* Pins that must differ. */
constexpr int hapsim_pins[] = {
    MOTOR_PIN_A,
    MOTOR_PIN_B,
    ENABLE_PIN,
#if SENSOR != AS5600
    SENSOR_PIN_A,
#elif defined(PIN_WIRE_SDA)
    PIN_WIRE_SDA,
    PIN_WIRE_SCL,
#endif
#if SENSOR == ENCODER
    SENSOR_PIN_B,
#endif
#if defined(__AVR__) && !defined(USBCON)
    0,
    1,
#endif
};
constexpr int HAPSIM_PINS = sizeof hapsim_pins / sizeof *hapsim_pins;
constexpr bool hapsim_is_alone(int pin, int at) {
    return at == HAPSIM_PINS ||
           ((hapsim_pins[at] == NO_PIN || hapsim_pins[at] != hapsim_pins[pin]) && hapsim_is_alone(pin, at + 1));
}
constexpr bool hapsim_differ(int pin) {
    return pin == HAPSIM_PINS || (hapsim_is_alone(pin, pin + 1) && hapsim_differ(pin + 1));
}
static_assert(hapsim_differ(0), "one pin has two uses: compare MOTOR_PIN_A, MOTOR_PIN_B, ENABLE_PIN, SENSOR_PIN_A, "
                                "SENSOR_PIN_B, the pins of I2C and, on an AVR without USB, the serial port's 0 and 1");

/* Some cores know their pins only at run time: nothing is checked there. */
#define HAPSIM_MAY_BE(condition) (!__builtin_constant_p(condition) || (condition))
#ifdef digitalPinHasPWM
static_assert(HAPSIM_MAY_BE(digitalPinHasPWM(MOTOR_PIN_A)), "MOTOR_PIN_A: this pin has no PWM");
static_assert(DRIVER != TWO_PWMS || HAPSIM_MAY_BE(digitalPinHasPWM(MOTOR_PIN_B)), "MOTOR_PIN_B: this pin has no PWM");
#endif
#if defined(__AVR_ATmega328P__) /* the pins of timer 0, and of a Leonardo's timer 4 */
#define HAPSIM_IS_SLOW(pin) ((pin) == 5 || (pin) == 6)
#elif defined(__AVR_ATmega2560__)
#define HAPSIM_IS_SLOW(pin) ((pin) == 4 || (pin) == 13)
#elif defined(__AVR_ATmega32U4__)
#define HAPSIM_IS_SLOW(pin) ((pin) == 3 || (pin) == 11 || (pin) == 6 || (pin) == 13)
#else
#define HAPSIM_IS_SLOW(pin) false
#endif
static_assert(!HAPSIM_IS_SLOW(MOTOR_PIN_A) && (DRIVER != TWO_PWMS || !HAPSIM_IS_SLOW(MOTOR_PIN_B)),
              "MOTOR_PIN: the timer of this pin is slow, or that of micros(); take 3, 9, 10 or 11 on an Uno, "
              "2, 3 or 5 to 12 on a Mega, 5, 9 or 10 on a Leonardo");
#if SENSOR == ENCODER && defined(digitalPinToInterrupt) && defined(NOT_AN_INTERRUPT)
static_assert(HAPSIM_MAY_BE(digitalPinToInterrupt(SENSOR_PIN_A) != NOT_AN_INTERRUPT),
              "SENSOR_PIN_A: this pin has no interrupt");
static_assert(HAPSIM_MAY_BE(digitalPinToInterrupt(SENSOR_PIN_B) != NOT_AN_INTERRUPT),
              "SENSOR_PIN_B: this pin has no interrupt");
#endif
#if SENSOR == POTENTIOMETER && defined(__AVR__)
static_assert(SENSOR_PIN_A >= PIN_A0, "SENSOR_PIN_A: an analogue pin, such as A0");
#endif

static_assert(SENSOR != AS5600 || COUNTS == 4096, "COUNTS: an AS5600 gives 4096 in a turn");
#if SENSOR == AS5600 && defined(ARDUINO_ARCH_SAMD)
#error "SENSOR: on this core a broken I2C wire stops loop(), with the motor on; take an encoder or a potentiometer"
#endif
#if SENSOR == POTENTIOMETER
static_assert(COUNTS == 1023 || COUNTS == 4095, "COUNTS: with a potentiometer 1023, or 4095 of 12 bits");
#endif
static_assert((COUNTS) > 0 && (TRAVEL) > 0, "COUNTS, TRAVEL: above zero; POSITION_SIGN sets the direction");
static_assert((FORCE_LIMIT) > 0 && (FORCE_LIMIT) <= (FULL_FORCE), "FORCE_LIMIT: above zero, at most FULL_FORCE");
static_assert((POSITION_SIGN == 1 || POSITION_SIGN == -1) && (FORCE_SIGN == 1 || FORCE_SIGN == -1),
              "POSITION_SIGN, FORCE_SIGN: 1 or -1");
static_assert((PWM_TOP) > 0 && (PWM_TOP) <= 16383, "PWM_TOP: 1 to 16383");
static_assert((RATE_HZ) > 0 && 1000000 % (RATE_HZ) == 0, "RATE_HZ: a sample must last a whole number of microseconds");

/* The wire and the processor work one after the other. */
#ifdef __AVR__
enum { HAPSIM_WORK_US = 8000 / (F_CPU / 1000000l) }; /* of an exchange: 0.5 ms at 16 MHz, from the emulated Uno */
#else
enum { HAPSIM_WORK_US = 50 };
#endif
static_assert((230000000l / (BAUD_RATE) + HAPSIM_WORK_US) * (RATE_HZ) <= 1000000,
              "RATE_HZ: too high: 23 bytes at BAUD_RATE, and on an Uno 0.5 ms of work, take longer than a sample");
#if defined(__AVR__) && !defined(USBCON)
constexpr long hapsim_baud = F_CPU / 8 / ((F_CPU / 4 / (BAUD_RATE)-1) / 2 + 1); /* that the core sets */
static_assert(hapsim_baud * 40 > 39l * (BAUD_RATE) && hapsim_baud * 40 < 41l * (BAUD_RATE),
              "BAUD_RATE: this clock misses it by more than 2.5 %; take 115200 (at 16 MHz), 250000, 500000 or 1000000");
#endif

#endif
