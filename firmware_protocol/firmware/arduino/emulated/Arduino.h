/* SPDX-License-Identifier: MIT */
/* The few calls of Arduino that the sketch uses, with the pins of an Uno. */
#ifndef EMULATED_PINS_H
#define EMULATED_PINS_H

#include "../../simplefoc/emulated/Arduino.h"

#define LOW 0
#define HIGH 1
#define INPUT_PULLUP 2
#define OUTPUT 1
#define CHANGE 1
#define PIN_A0 14
#define PIN_WIRE_SDA 18
#define PIN_WIRE_SCL 19
#define NOT_AN_INTERRUPT -1
#define digitalPinToInterrupt(pin) ((pin) == 2 ? 0 : ((pin) == 3 ? 1 : NOT_AN_INTERRUPT))
#define digitalPinHasPWM(pin) ((pin) == 3 || (pin) == 5 || (pin) == 6 || ((pin) >= 9 && (pin) <= 11))
static const uint8_t A0 = PIN_A0;

void pinMode(uint8_t pin, uint8_t mode);
void digitalWrite(uint8_t pin, uint8_t level);
int digitalRead(uint8_t pin);
void analogWrite(uint8_t pin, int duty);
void analogWriteFrequency(uint8_t pin, uint32_t frequency);
int analogRead(uint8_t pin);
void attachInterrupt(uint8_t number, void (*handler)(void), int mode);
void noInterrupts();
void interrupts();

#ifdef __AVR__
#include <avr/io.h>
enum { TIMER1A = 3, TIMER1B, TIMER2A = 7, TIMER2B };
extern volatile uint8_t *portInputRegister(uint8_t port);
extern uint8_t digitalPinToPort(uint8_t pin), digitalPinToBitMask(uint8_t pin), digitalPinToTimer(uint8_t pin);
#endif

#endif
