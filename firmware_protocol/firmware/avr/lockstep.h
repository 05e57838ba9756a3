/* SPDX-License-Identifier: MIT */
/* A chip that paces itself, as a device in lockstep: the harness stops its clock while the host thinks. The firmware is
 * the one that a board gets; it never hears of lockstep, which no device with a motor offers. */
#ifndef LOCKSTEP_H
#define LOCKSTEP_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

/* A whole frame of the chip, with its delimiter. In the one that declares the pacings lockstep is added, in place. True
 * where it is a position, which the host answers. */
bool offer_lockstep(uint8_t *frame, size_t bytes);

/* Bytes of the host: an ARM in lockstep becomes one that the device paces, in place. */
void take_lockstep(uint8_t *bytes, size_t count);

#endif
