/* What harness.c shares with a board that is an Arduino sketch, and a port that gives the sketch one byte at a time. */
#ifndef GIVEN_SERIAL_H
#define GIVEN_SERIAL_H

#include <Arduino.h>

extern "C" {
extern uint32_t now;
extern int32_t measured[], put_out[];
extern uint8_t found, said[4096];
extern bool room;
extern unsigned fed;
extern size_t said_bytes;
void knob_init(void);
void knob_take_byte(uint8_t byte);
void knob_tick(void);
bool knob_look(void);
void knob_obey(const char *line);
}

static int waiting = -1;
HardwareSerial Serial;

int HardwareSerial::available() {
    return waiting >= 0;
}

int HardwareSerial::read() {
    const int byte = waiting;
    waiting = -1;
    return byte;
}

int HardwareSerial::availableForWrite() {
    return room ? (int)(4096 - said_bytes) : 0;
}

size_t HardwareSerial::write(const uint8_t *bytes, size_t count) {
    for (size_t i = 0; i < count; i++) {
        said[said_bytes++] = bytes[i];
    }
    return count;
}

#endif
