/* SPDX-License-Identifier: MIT */
/* Makes a chip that paces itself look like a device in lockstep: the harness stops the chip's clock while the host
 * computes. The firmware is the one for a real board. It does not support lockstep, which no device with a motor may
 * offer. */
#ifndef LOCKSTEP_H
#define LOCKSTEP_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

/* Takes a whole frame of the chip, with its delimiter. If the frame declares the pacings, adds lockstep in place.
 * Returns true if the frame is a position, which the host answers. */
bool offer_lockstep(uint8_t *frame, size_t bytes);

/* Takes bytes of the host. Changes an ARM in lockstep, in place, to an ARM paced by the device. */
void take_lockstep(uint8_t *bytes, size_t count);

#endif
