/* SPDX-License-Identifier: MIT */
/* hAPI, the protocol of Haply's boards (firmware M3 V1.5), on a serial port. Its frames have no mark, check or time-out:
 *
 *     00 id                                                        reset: forgets the set-up; the motors keep their torque
 *     01 id  motors, directions  encoders, directions  0  0  per encoder: offset (degrees), counts a turn
 *     02 id  torque of each motor (N m)             answer: id, angle of each encoder (degrees)
 *
 * in ports' order; numbers are f32, little endian. The firmware puts the torques out, then reads the encoders. It keeps
 * the last torque for ever. */
#ifndef HAPI_H
#define HAPI_H

#include <stdbool.h>
#include <stdint.h>

#define HAPI_TORQUE_LIMIT 0.123 /* N m: MAX_TORQUE of the firmware, full duty */

typedef struct {
    uint8_t port[2];           /* of arm 0 and arm 1: 1 or 2 */
    uint8_t motor_direction[2]; /* of these, as the wires are: 0 clockwise, 1 counterclockwise */
    uint8_t encoder_direction[2];
    float at_start[2]; /* degrees, where the stops hold the arms while the bridge starts */
    float counts;      /* a turn */
} hapi_wiring;

/* Opens the port, raw, for this process alone; -1 with a sentence on standard error. */
int hapi_open(const char *path);

/* Resets and sets up; the encoders read `degrees` from now on. Nothing is answered. False: the port is gone. */
bool hapi_set_up(int port, const hapi_wiring *wiring, const float degrees[2]);

typedef enum { HAPI_ANSWERED, HAPI_SILENT, HAPI_GARBLED, HAPI_NOT_SET_UP, HAPI_GONE } hapi_result;

/* Puts torques (N m) of arm 0 and 1 out and reads their angles (degrees). HAPI_GARBLED: bytes came that are no answer, or
 * more than one; `degrees` is then as it was. Waits HAPI_ANSWER_MS at most. */
hapi_result hapi_exchange(int port, const hapi_wiring *wiring, const double torque[2], double degrees[2]);

/* Brings both ends into step: bytes that are no command, and within a frame no torque, then silence, then what came
 * meanwhile is dropped. */
void hapi_find_back(int port);

/* For a process whose partner died: as above, and zero torque, whatever was under way. Async-signal-safe. */
void hapi_release(int port);

#endif
