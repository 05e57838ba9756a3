/* The integers of a line as the firmware works them out: `shifted_product FACTOR WAY SHIFT`, FACTOR of 16 bits with a sign
 * or without, or `bound BOUND LIMIT`; one a line of standard input, each answered with its result. */
#include "hapsim_device.c"

#include <stdio.h>

uint32_t hapsim_port_now(void) {
    return 0;
}

uint8_t hapsim_port_measure(int32_t *counts, uint8_t parts) {
    (void)counts, (void)parts;
    return HAPSIM_NO_FAULT;
}

void hapsim_port_put_forces(const int32_t *counts) {
    (void)counts;
}

bool hapsim_port_write(const uint8_t *bytes, size_t count) {
    (void)bytes;
    return count > 0;
}

void hapsim_port_feed_watchdog(void) {
}

void hapsim_port_begin(void) {
}

void hapsim_port_hold_tick(void) {
}

void hapsim_port_let_tick(void) {
}

int main(void) {
    char what[16];
    long one, other, shift;
    while (scanf("%15s %ld %ld", what, &one, &other) == 3) {
        long result;
        if (what[0] == 's' && scanf("%ld", &shift) == 1) {
            result = shifted_product((uint16_t)(one & 0xFFFF), one < 0, (int32_t)other, (int8_t)shift);
        } else {
            const bound_unit unit = bound_unit_of((int32_t)other);
            result = bound_in_counts((int16_t)one, &unit);
        }
        printf("%ld\n", result);
    }
    return 0;
}
