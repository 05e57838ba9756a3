/* Streams of frames, damaged at random, through the decoder: `mutations COUNT SEED`. Built with sanitizers, so that a
 * byte read or written out of place ends it. What was accepted undamaged has to be what was sent. */
#define HAPSIM_HOST_WORDS 49
#include "hapsim_protocol.h"

#include <stdio.h>
#include <stdlib.h>

static uint64_t seed;

/* xorshift64*: the same streams everywhere. */
static uint32_t chance(uint32_t below) {
    seed ^= seed >> 12;
    seed ^= seed << 25;
    seed ^= seed >> 27;
    return (uint32_t)(seed * 2685821657736338717u >> 32) % below;
}

static hapsim_format random_format(void) {
    const uint8_t channels = (uint8_t)(1 + chance(HAPSIM_MAX_CHANNELS));
    const uint8_t parts[] = {0, HAPSIM_WITH_VELOCITY, HAPSIM_WITH_ACCELERATION | HAPSIM_WITH_LINE,
                             HAPSIM_PART_BITS & ~HAPSIM_WITH_COMMANDS, HAPSIM_PART_BITS & ~HAPSIM_WITH_LINE};
    return chance(4) ? hapsim_armed_format(channels, parts[chance(5)]) : hapsim_setup_format();
}

/* A frame of the host, as the host would write it: the header can only write those of the device. `spoilt`: a byte of
 * what is encoded is wrong, a code perhaps, and the check is right over it. */
static size_t write_to_device(const hapsim_format *format, uint8_t *out, uint8_t type, uint16_t number, bool spoilt) {
    size_t at = 1;
    out[at++] = (uint8_t)(type << 4 | number >> 8);
    out[at++] = (uint8_t)number;
    for (int i = 1 + 4 * hapsim_words_to_device(format); i > 0; i--) {
        out[at++] = chance(3) ? (uint8_t)chance(256) : 0;
    }
    hapsim_stuff(out, at);
    if (spoilt) {
        out[chance((uint32_t)at)] = (uint8_t)(1 + chance(255));
    }
    at += hapsim_put_check(format, hapsim_check(format, out, at), out + at);
    out[at++] = 0;
    return at;
}

static size_t damage(uint8_t *bytes, size_t count) {
    for (uint32_t times = chance(4); times > 0 && count > 1; times--) {
        const size_t at = chance((uint32_t)count);
        switch (chance(4)) {
        case 0: bytes[at] ^= (uint8_t)(1u << chance(8)); break;
        case 1: bytes[at] = (uint8_t)chance(256); break;
        case 2: memmove(bytes + at, bytes + at + 1, --count - at); break; /* lost */
        default: memmove(bytes + at + 1, bytes + at, count++ - at); break; /* twice */
        }
    }
    return count;
}

static bool reads_back(hapsim_decoder *decoder, const hapsim_format *format) {
    uint8_t bytes[HAPSIM_RECENT];
    const uint8_t type = (uint8_t)(1 + chance(4));
    const uint16_t number = (uint16_t)chance(4096);
    const size_t count = write_to_device(format, bytes, type, number, false);
    bool accepted = false;
    for (size_t i = 0; i < count; i++) {
        accepted = hapsim_take_byte(decoder, bytes[i]);
    }
    return accepted && decoder->type == type && decoder->number == number;
}

int main(int count, char **words) {
    hapsim_decoder decoder;
    unsigned long lost = 0, streams = count > 2 ? strtoul(words[1], NULL, 10) : 0;
    seed = count > 2 ? strtoull(words[2], NULL, 10) : 1;
    hapsim_decoder_init(&decoder);
    for (unsigned long i = 0; i < streams; i++) {
        uint8_t bytes[4 * HAPSIM_RECENT];
        size_t length = 0;
        const hapsim_format format = random_format();
        hapsim_use_format(&decoder, format);
        for (uint32_t frames = 1 + chance(2); frames > 0; frames--) {
            const hapsim_format spoken = chance(8) ? format : random_format();
            const uint16_t number = (uint16_t)chance(4096);
            length += write_to_device(&spoken, bytes + length, (uint8_t)chance(16), number, chance(4) == 0);
        }
        length = damage(bytes, length);
        for (size_t at = 0; at < length; at++) {
            hapsim_take_byte(&decoder, bytes[at]);
        }
        hapsim_take_byte(&decoder, 0); /* whatever it was, the next whole frame is read */
        lost += !reads_back(&decoder, &format);
    }
    printf("%lu %lu\n", streams, lost);
    return lost > 0;
}
