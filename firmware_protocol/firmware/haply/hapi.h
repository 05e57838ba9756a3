/* SPDX-License-Identifier: MIT */
/* hAPI, the protocol of Haply's boards (firmware M3 V1.5), on a serial port. Its frames have no mark, check or timeout:
 *
 *     00 id                                                        reset: forgets the set-up; the motors keep their torque
 *     01 id  motors, directions  encoders, directions  0  0  per encoder: offset (degrees), counts a turn
 *     02 id  torque of each motor (N m)             answer: id, angle of each encoder (degrees)
 *
 * The values are in the order of the ports; numbers are f32, little endian. The firmware puts the torques out, then
 * reads the encoders. It keeps the last torque for ever. */
#ifndef HAPI_H
#define HAPI_H

#include <stdbool.h>
#include <stdint.h>

#define HAPI_TORQUE_LIMIT 0.123 /* N m: MAX_TORQUE of the firmware, full duty */

typedef struct {
    uint8_t port[2];           /* of arm 0 and arm 1: 1 or 2 */
    uint8_t motor_direction[2]; /* of these ports, as wired: 0 clockwise, 1 counterclockwise */
    uint8_t encoder_direction[2];
    float at_start[2]; /* degrees at the stops, where the arms are while the bridge starts */
    float counts;      /* per turn */
} hapi_wiring;

/* Opens the port, raw, for this process alone. Returns its descriptor, or -1 with a message on standard error. */
int hapi_open(const char *path);

/* Resets the board and sets it up; its encoders then read `degrees`. The board does not answer. Returns false if the
 * port is gone. */
bool hapi_set_up(int port, const hapi_wiring *wiring, const float degrees[2]);

typedef enum { HAPI_ANSWERED, HAPI_SILENT, HAPI_GARBLED, HAPI_NOT_SET_UP, HAPI_GONE } hapi_result;

/* Puts out the torques (N m) of arm 0 and 1, and reads their angles (degrees). Waits HAPI_ANSWER_MS at most.
 * HAPI_GARBLED: the bytes that came are no answer, or more than one; `degrees` stays unchanged. */
hapi_result hapi_exchange(int port, const hapi_wiring *wiring, const double torque[2], double degrees[2]);

/* Resynchronizes both ends. Sends bytes that are no command and, within a frame, no torque. Then waits for silence and
 * drops what came meanwhile. */
void hapi_find_back(int port);

/* Sends the same bytes and then zero torque, whatever frame was under way. For a process whose partner died.
 * Async-signal-safe. */
void hapi_release(int port);

#endif
