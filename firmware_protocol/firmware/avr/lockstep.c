/* SPDX-License-Identifier: MIT */
#include "lockstep.h"

#include "../../hapsim_protocol.h"

enum { TO_HOST = 7, TO_DEVICE = 8, CHECK = 3 }; /* bytes in the set-up format: encoded, each way, and of the check */

static bool open_frame(uint8_t *frame, size_t encoded) {
    const hapsim_format format = hapsim_setup_format();
    uint8_t check[5];
    hapsim_put_check(&format, hapsim_check(&format, frame, encoded), check);
    return !memcmp(check, frame + encoded, CHECK) && hapsim_unstuff(frame, encoded);
}

static void close_frame(uint8_t *frame, size_t encoded) {
    const hapsim_format format = hapsim_setup_format();
    hapsim_stuff(frame, encoded);
    hapsim_put_check(&format, hapsim_check(&format, frame, encoded), frame + encoded);
}

bool offer_lockstep(uint8_t *frame, size_t bytes) {
    if (bytes == TO_HOST + CHECK + 1 && open_frame(frame, TO_HOST)) {
        if (frame[1] == HAPSIM_DESCRIPTION << 4 && frame[2] == HAPSIM_REG_PACINGS) {
            frame[3] |= 1 << HAPSIM_LOCKSTEP;
        }
        close_frame(frame, TO_HOST);
        return false;
    }
    return bytes > 1 && (frame[1] >> 4 == HAPSIM_POSITION || frame[1] >> 4 == HAPSIM_POSITION_HELD);
}

void take_lockstep(uint8_t *bytes, size_t count) {
    for (size_t end = TO_DEVICE + CHECK; end < count; end++) {
        uint8_t *frame = bytes + end - TO_DEVICE - CHECK;
        uint8_t copy[TO_DEVICE + CHECK];
        memcpy(copy, frame, sizeof copy);
        if (bytes[end] == 0 && open_frame(copy, TO_DEVICE) && copy[1] >> 4 == HAPSIM_ARM &&
            (copy[3] & ~HAPSIM_PART_BITS) == HAPSIM_LOCKSTEP) {
            copy[3] = (uint8_t)((copy[3] & HAPSIM_PART_BITS) | HAPSIM_PACED_BY_DEVICE);
            close_frame(copy, TO_DEVICE);
            memcpy(frame, copy, sizeof copy);
        }
    }
}
