/* Drives hapsim_protocol.h by lines on standard input, one answer or more for each; test_protocol_header.py speaks it.
 *
 *   new                          a decoder as at power-up
 *   format CHANNELS PARTS        0: set-up, else armed with these bits of ARM; for reading and writing
 *   read HEX                     "frame TYPE NUMBER ARGUMENT COUNT..." for every frame
 *   counters                     accepted, crc, length, form errors, garbage bytes
 *   write TYPE NUMBER COUNT...   a frame to the host, in hexadecimal
 *   f64 VALUE                    its two words
 *   age SAMPLE NUMBER            the age
 */
#define HAPSIM_HOST_WORDS 49
#include "hapsim_protocol.h"

#include <stdio.h>
#include <stdlib.h>

static hapsim_decoder decoder;
static uint8_t bytes[4096];

static size_t parse_hex(const char *text) {
    size_t count = 0;
    unsigned value;
    while (count < sizeof bytes && sscanf(text + 2 * count, "%2x", &value) == 1) {
        bytes[count++] = (uint8_t)value;
    }
    return count;
}

static void read_bytes(size_t count) {
    for (size_t i = 0; i < count; i++) {
        if (!hapsim_take_byte(&decoder, bytes[i])) {
            continue;
        }
        printf("frame %u %u %u", decoder.type, decoder.number, decoder.argument);
        for (unsigned i = 0; i < hapsim_words_to_device(&decoder.format); i++) {
            printf(" %ld", (long)decoder.payload[i]);
        }
        printf("\n");
    }
}

static void write_frame(char *text) {
    int32_t payload[HAPSIM_MAX_WORDS];
    uint8_t out[HAPSIM_MAX_FRAME];
    uint8_t type = (uint8_t)strtol(text, &text, 10);
    uint16_t number = (uint16_t)strtol(text, &text, 10);
    for (unsigned i = 0; i < hapsim_words_to_host(&decoder.format); i++) {
        payload[i] = (int32_t)strtol(text, &text, 10);
    }
    size_t count = hapsim_write_to_host(&decoder.format, out, type, number, payload);
    for (size_t i = 0; i < count; i++) {
        printf("%02x", out[i]);
    }
    printf("\n");
}

static void obey(char *line) {
    char *rest = line + strcspn(line, " \n");
    if (strncmp(line, "new", 3) == 0) {
        hapsim_decoder_init(&decoder);
    } else if (strncmp(line, "format", 6) == 0) {
        uint8_t channels = (uint8_t)strtol(rest, &rest, 10);
        uint8_t parts = (uint8_t)strtol(rest, &rest, 10);
        hapsim_use_format(&decoder, channels == 0 ? hapsim_setup_format() : hapsim_armed_format(channels, parts));
    } else if (strncmp(line, "read ", 5) == 0) {
        read_bytes(parse_hex(rest + 1));
    } else if (strncmp(line, "counters", 8) == 0) {
        printf("%lu %lu %lu %lu %lu\n", (unsigned long)decoder.accepted, (unsigned long)decoder.crc_errors,
               (unsigned long)decoder.length_errors, (unsigned long)decoder.form_errors,
               (unsigned long)decoder.garbage_bytes);
    } else if (strncmp(line, "write ", 6) == 0) {
        write_frame(rest);
    } else if (strncmp(line, "f64 ", 4) == 0) {
        double value = strtod(rest, NULL);
        printf("%lu %lu\n", (unsigned long)hapsim_f64_word(value, false), (unsigned long)hapsim_f64_word(value, true));
    } else if (strncmp(line, "age ", 4) == 0) {
        uint32_t sample = (uint32_t)strtoul(rest, &rest, 10);
        printf("%u\n", hapsim_age(sample, (uint16_t)strtoul(rest, NULL, 10)));
    }
}

int main(void) {
    static char line[16384];
    while (fgets(line, sizeof line, stdin)) {
        obey(line);
    }
    return 0;
}
