/* SPDX-License-Identifier: MIT */
/* The few calls of Arduino that a knob uses. */
#ifndef ARDUINO_H
#define ARDUINO_H

#include <stddef.h>
#include <stdint.h>

class Stream {
public:
    virtual int available() = 0;
    virtual int read() = 0;
    virtual int availableForWrite() = 0;
    virtual size_t write(const uint8_t *bytes, size_t count) = 0;
};

class HardwareSerial : public Stream {
public:
    void begin(unsigned long) {}
    int available() override;
    int read() override;
    int availableForWrite() override;
    size_t write(const uint8_t *bytes, size_t count) override;
};
extern HardwareSerial Serial;

unsigned long micros();
void setup();
void loop();

#endif
