/* SPDX-License-Identifier: MIT */
/* Arduino's main loop, and its Serial on the serial port of hardware.h. */
#include <Arduino.h>
extern "C" {
#include "hardware.h"
int run_board(void);
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

int run_board(void) {
    start_hardware();
    note_force(0, 0); /* the force after the reset */
    setup();
    for (;;) {
        loop();
        rest();
    }
}
