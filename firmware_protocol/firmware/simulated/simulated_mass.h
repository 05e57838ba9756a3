/* SPDX-License-Identifier: MIT */
/* A mass that the emulated boards move in place of an actuator and an encoder: 0.2 kg with 1 N s/m of viscous friction.
 * It starts at 0.1 m/s when the device is armed. It is the device of configs/first_touch.yaml, in integers. */
#ifndef SIMULATED_MASS_H
#define SIMULATED_MASS_H

#include <stdbool.h>
#include <stdint.h>

#ifndef SIMULATED_STEPS
#define SIMULATED_STEPS 1 /* moves in a sample; more on a board that follows lines */
#endif

/* On the wire: 1 nm, 10 nN (1 uN if the board follows lines), 10 nm/s, 50 nm/s^2 per count. */
typedef struct {
#if SIMULATED_STEPS == 1
    int64_t position; /* 2^-24 nm */
    int64_t velocity; /* the same per move */
#else /* in 32 bits, for a small processor */
    int32_t position; /* nm */
    uint8_t fraction; /* 2^-8 nm more */
    int32_t velocity; /* 2^-7 nm per move */
#endif
} simulated_mass;

void simulated_mass_flick(simulated_mass *mass);

/* Moves the mass by one sample of 1 ms under a held force in counts; by a local period if the board follows lines. Exact,
 * except for the rounding of integers. */
void simulated_mass_move(simulated_mass *mass, int32_t force);

/* Writes the position in counts. Returns false if it does not fit 32 bits, or is beyond 2 m if the board follows lines. */
bool simulated_mass_position(const simulated_mass *mass, int32_t *counts);

/* Returns the velocity in counts; one that does not fit 32 bits saturates. */
int32_t simulated_mass_velocity(const simulated_mass *mass);

/* Returns the acceleration under a force in counts, in counts; one that does not fit 32 bits saturates. */
int32_t simulated_mass_acceleration(const simulated_mass *mass, int32_t force);

#endif
