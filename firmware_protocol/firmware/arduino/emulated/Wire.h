/* SPDX-License-Identifier: MIT */
#ifndef WIRE_H
#define WIRE_H

#include <Arduino.h>

#ifndef WIRE_LIMIT
#define WIRE_LIMIT setWireTimeout(uint32_t, bool) /* each core has its own */
#endif

class TwoWire {
public:
    void begin() {}
    void setClock(uint32_t) {}
    void WIRE_LIMIT;
    void beginTransmission(uint8_t address);
    size_t write(uint8_t byte);
    uint8_t endTransmission(bool stop = true);
    uint8_t requestFrom(uint8_t address, uint8_t count);
    int read();
};
extern TwoWire Wire;

#endif
