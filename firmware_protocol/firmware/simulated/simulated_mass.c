/* SPDX-License-Identifier: MIT */
/* The motion is exact over one move of T with a held force F. With p = b/m, the velocity decays by exp(-pT), and the
 * position lags by (1 - exp(-pT))/p. The constants below are for m = 0.2 kg, b = 1 N s/m and T = 1 ms or a
 * local period, in the units of simulated_mass.h. They are rounded to 32 bits; a test recomputes them.
 *
 *     velocity += PUSH_V F - DECAY velocity       DECAY  = 1 - exp(-pT)            PUSH_V = T (1 - exp(-pT))/b
 *     position += velocity - LAG velocity         LAG    = 1 - (1 - exp(-pT))/(pT) PUSH_X = T LAG/b
 *                 + PUSH_X F
 */
#include "simulated_mass.h"

#define DECAY 2741918561u  /* 2^-39 */
#define LAG 2744203492u    /* 2^-40 */
#define PUSH_V 3509655758u /* 2^-22, from counts of force */
#define PUSH_X 3512580470u /* 2^-23 */
#define FRACTION (SIMULATED_STEPS == 1 ? 24 : 7) /* bits below 1 nm, of the velocity */
#define FLICK ((100000ll << FRACTION) / SIMULATED_STEPS) /* 0.1 m/s */
#define FORCE_COUNT (SIMULATED_STEPS == 1 ? 1 : 100) /* 10 nN */
#define COUNTS(velocity) (((int64_t)(velocity) * (100 * SIMULATED_STEPS) + (1l << (FRACTION - 1))) >> FRACTION)

#if SIMULATED_STEPS == 1
/* Returns |value| * factor / 2^shift for shift >= 32. It works by halves, with the 32-bit products that a small
 * processor has. */
static uint64_t share(uint64_t value, uint32_t factor, uint8_t shift) {
    const uint64_t upper = (uint64_t)(uint32_t)(value >> 32) * factor;
    const uint64_t lower = (uint64_t)(uint32_t)value * factor;
    return (upper + (lower >> 32)) >> (shift - 32);
}

/* Works on the magnitude, so that rounding goes towards zero on both sides and adds no push. */
static int64_t part_of(int64_t value, uint32_t factor, uint8_t shift) {
    return value < 0 ? -(int64_t)share((uint64_t)-value, factor, shift) : (int64_t)share((uint64_t)value, factor, shift);
}

static int64_t push(int32_t force, uint32_t factor, uint8_t shift) {
    const uint32_t magnitude = force < 0 ? 0u - (uint32_t)force : (uint32_t)force;
    const int64_t moved = (int64_t)((uint64_t)magnitude * factor >> shift);
    return force < 0 ? -moved : moved;
}

void simulated_mass_move(simulated_mass *mass, int32_t force) {
    const int64_t velocity = mass->velocity;
    mass->position += velocity - part_of(velocity, LAG, 40) + push(force, PUSH_X, 23);
    mass->velocity += push(force, PUSH_V, 22) - part_of(velocity, DECAY, 39);
}

/* A right shift of a negative number keeps the sign with all compilers of these boards. */
bool simulated_mass_position(const simulated_mass *mass, int32_t *counts) {
    const int64_t rounded = (mass->position + (1l << (FRACTION - 1))) >> FRACTION;
    *counts = (int32_t)rounded;
    return rounded == *counts;
}
#else
/* A local period: DECAY and PUSH_V of this T, for counts of 1 uN, in 16 bits. The position moves by the mean of the
 * velocities before and after. That differs from the formula above by (pT)^2/12 < 4e-8 of the way. */
#if SIMULATED_STEPS == 5
#define STEP_DECAY 16769  /* 2^-24 */
#define STEP_PUSH_V 53660 /* 2^-STEP_SHIFT */
#define STEP_SHIFT 21
#elif SIMULATED_STEPS == 10
#define STEP_DECAY 8387
#define STEP_PUSH_V 53674
#define STEP_SHIFT 23
#endif
#define FARTHEST 2000000000l

/* Apart, else avr-gcc multiplies 32 bits by 32. */
static __attribute__((noinline)) uint32_t times(uint16_t one, uint16_t other) {
    return (uint32_t)one * other;
}

/* Returns value * factor / 2^16, rounded down. */
static int32_t share(int32_t value, uint16_t factor) {
    const uint32_t product = times(factor, (uint16_t)((uint32_t)value >> 16)) + (times(factor, (uint16_t)value) >> 16);
    return (int32_t)(value < 0 ? product - ((uint32_t)factor << 16) : product);
}

void simulated_mass_move(simulated_mass *mass, int32_t force) {
    const int32_t before = mass->velocity;
    const int32_t after = before + (share(force * (1l << (24 - STEP_SHIFT)), STEP_PUSH_V) >> 8) - (share(before, STEP_DECAY) >> 8);
    const int32_t moved = before + after + mass->fraction;
    mass->velocity = after;
    mass->position += moved >> 8;
    mass->fraction = (uint8_t)(moved & 255);
}

bool simulated_mass_position(const simulated_mass *mass, int32_t *counts) {
    *counts = mass->position;
    return mass->position <= FARTHEST && mass->position >= -FARTHEST;
}
#endif

void simulated_mass_flick(simulated_mass *mass) {
    mass->position = 0;
    mass->velocity = FLICK;
}

static int32_t saturated(int64_t counts) {
    return counts > INT32_MAX ? INT32_MAX : counts < INT32_MIN ? INT32_MIN : (int32_t)counts;
}

int32_t simulated_mass_velocity(const simulated_mass *mass) {
    return saturated(COUNTS(mass->velocity));
}

/* (F - b v)/m with b = 1 N s/m and m = 0.2 kg: a count of force (10 nN), and one of velocity (10 nm/s), is 50 nm/s^2. */
int32_t simulated_mass_acceleration(const simulated_mass *mass, int32_t force) {
    return saturated((int64_t)force * FORCE_COUNT - COUNTS(mass->velocity));
}
