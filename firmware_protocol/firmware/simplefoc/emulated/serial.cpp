/* SPDX-License-Identifier: MIT */
/* Arduino's Serial on the serial port of hardware.h. */
#include <Arduino.h>
extern "C" {
#include "hardware.h"
[[noreturn]] void __cxa_pure_virtual(void);
}

HardwareSerial Serial;

void __cxa_pure_virtual(void) {
    for (;;) {
    }
}

int HardwareSerial::available() {
    return bytes_to_read();
}

int HardwareSerial::read() {
    const int byte = next_byte();
    return byte == BYTES_WERE_LOST ? next_byte() : byte;
}

int HardwareSerial::availableForWrite() {
    return (int)room_to_send();
}

size_t HardwareSerial::write(const uint8_t *bytes, size_t count) {
    send_bytes(bytes, count);
    return count;
}
