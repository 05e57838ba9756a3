/* SPDX-License-Identifier: MIT */
/* The wire protocol of hapsim, version 1: the device's half, for firmware. C99, header only, no allocation, and no
 * library beyond memcpy. PROTOCOL.md is the specification; vectors.json has the test vectors.
 *
 *     hapsim_decoder in;
 *     hapsim_decoder_init(&in);                              // listens for the set-up format
 *     ...
 *     if (hapsim_take_byte(&in, byte_from_the_uart))         // a whole, valid frame has arrived
 *         switch (in.type) { case HAPSIM_FORCE: ... }        // in.number, in.argument, in.payload[]
 *
 *     uint8_t out[HAPSIM_MAX_FRAME];
 *     size_t bytes = hapsim_write_to_host(&in.format, out, HAPSIM_POSITION, sample, positions);
 *
 * The functions share no data: an interrupt may decode while other code writes frames. Only one context at a time may
 * use a decoder.
 */
#ifndef HAPSIM_PROTOCOL_H
#define HAPSIM_PROTOCOL_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <string.h>

/* An AVR copies constants to RAM unless they are marked to stay in flash. */
#ifdef __AVR__
#include <avr/pgmspace.h>
#define HAPSIM_IN_FLASH PROGMEM
#define HAPSIM_FLASH_16(at) pgm_read_word(at)
#define HAPSIM_FLASH_32(at) pgm_read_dword(at)
#else
#define HAPSIM_IN_FLASH
#define HAPSIM_FLASH_16(at) (*(at))
#define HAPSIM_FLASH_32(at) (*(at))
#endif

#ifdef __GNUC__
#define HAPSIM_APART __attribute__((noinline, unused))
#else
#define HAPSIM_APART inline
#endif

#define HAPSIM_VERSION 1u
#define HAPSIM_SCHEMA_HASH 0x314a417fu
#define HAPSIM_VELOCITY_MARK 0x56454c01u
#define HAPSIM_ACCELERATION_MARK 0x41434302u
#define HAPSIM_HAND_FORCE_MARK 0x46524304u
#define HAPSIM_INPUTS_MARK 0x5349470eu
#define HAPSIM_LINE_MARK 0x4c494e03u
#define HAPSIM_COMMAND_MARK 0x434d4405u
#define HAPSIM_SETUP_SEED 0x4853u
#define HAPSIM_MAX_CHANNELS 16
#define HAPSIM_MAX_WORDS 62 /* of a payload, so that COBS adds one byte */
#define HAPSIM_SHORT_CRC_WORDS 3
#define HAPSIM_SAMPLE_MODULUS 4096u
#define HAPSIM_MAX_WATCHDOG_SAMPLES 2047u
#define HAPSIM_MAX_FRAME 253 /* bytes, delimiter included: 15 channels with all parts, to the host */

/* Frame types: host to device, then device to host. */
enum { HAPSIM_DESCRIBE = 0x1, HAPSIM_ARM = 0x2, HAPSIM_FORCE = 0x3, HAPSIM_DISARM = 0x4 };
enum { HAPSIM_DESCRIPTION = 0x9, HAPSIM_POSITION = 0xA, HAPSIM_POSITION_HELD = 0xB, HAPSIM_STATUS = 0xC };

/* The argument of ARM: a pacing, and a bit for each part that the host requests behind positions and forces. The
 * register `pacings` has one bit for each pacing that the device supports. */
enum { HAPSIM_PACED_BY_DEVICE = 0, HAPSIM_PACED_BY_HOST = 1, HAPSIM_LOCKSTEP = 2 };
enum {
    HAPSIM_WITH_VELOCITY = 0x80,
    HAPSIM_WITH_ACCELERATION = 0x20,
    HAPSIM_WITH_FORCE = 0x40, /* of the hand on the handle */
    HAPSIM_WITH_LINE = 0x04,
    HAPSIM_WITH_COMMANDS = 0x08, /* positions that the device's servo follows */
    HAPSIM_WITH_WORDS = 0x10,
    HAPSIM_PART_BITS = 0xFC
};

/* Payload 0 of a status frame: state | fault << 8. */
enum { HAPSIM_IDLE = 0, HAPSIM_ARMED = 1, HAPSIM_LATCHED = 2 };
enum {
    HAPSIM_NO_FAULT = 0,
    HAPSIM_HOST_QUIET = 1,
    HAPSIM_POSITION_OUT_OF_RANGE = 2,
    HAPSIM_WRONG_SCHEMA = 3,
    HAPSIM_WRONG_PACING = 4,
    HAPSIM_WRONG_WATCHDOG = 5,
    HAPSIM_HARDWARE = 6,
    HAPSIM_WRONG_SENSING = 7
};

/* Registers, 32 bits each; an f64 takes two. Per channel: HAPSIM_REG_CHANNEL + HAPSIM_CHANNEL_WORDS * channel + ... */
enum {
    HAPSIM_REG_VERSION = 0,
    HAPSIM_REG_SCHEMA = 1,
    HAPSIM_REG_CHANNELS = 2,
    HAPSIM_REG_PACINGS = 3,
    HAPSIM_REG_RATE = 4,
    HAPSIM_REG_MAX_WATCHDOG = 6,
    HAPSIM_REG_FAULT = 7,
    HAPSIM_REG_ACCEPTED = 8,
    HAPSIM_REG_REJECTED = 9,
    HAPSIM_REG_HELD = 10,
    HAPSIM_REG_EXPIRED = 11,
    HAPSIM_REG_LIMITED = 12,
    HAPSIM_REG_ROTARY = 13,
    HAPSIM_REG_BRIDGE = 14,
    HAPSIM_REG_SENSORS = 15,
    HAPSIM_REG_NAME = 16,
    HAPSIM_NAME_WORDS = 4,
    HAPSIM_REG_BOARD_STEPS = 20,
    HAPSIM_REG_BOARD_DELAY = 21,
    HAPSIM_REG_BOARD_WINDOW = 22,
    HAPSIM_REG_KEPT_REPORTS = 23,
    HAPSIM_REG_CHANNEL = 32,
    HAPSIM_CHANNEL_WORDS = 8,
    HAPSIM_REG_POSITION_SCALE = 0,
    HAPSIM_REG_FORCE_SCALE = 2,
    HAPSIM_REG_FORCE_LIMIT = 4,
    HAPSIM_REG_VELOCITY_SCALE = 6,
    HAPSIM_REG_MORE = 160, /* HAPSIM_MORE_WORDS more for each channel, the first two of them the acceleration scale */
    HAPSIM_REG_LINE_SHIFTS = 162,
    HAPSIM_REG_LARGEST = 163,
    HAPSIM_REG_HAND_FORCE_SCALE = 164,
    HAPSIM_REG_HAND_FORCE_RANGE = 166,
    HAPSIM_REG_SPEED_LIMIT = 168,
    HAPSIM_REG_BRAKING = 170,
    HAPSIM_REG_BANDWIDTH = 172,
    HAPSIM_REG_SERVO_DAMPING = 174,
    HAPSIM_MORE_WORDS = 16,
    HAPSIM_REGISTERS = 416
};

/* The bits of the register `sensors`. */
enum {
    HAPSIM_SENSES_ACCELERATION = 1,
    HAPSIM_SENSES_FORCE = 2,
    HAPSIM_HAS_DIGITAL_WORD = 4,
    HAPSIM_FOLLOWS_LINES = 8,
    HAPSIM_FOLLOWS_COMMANDS = 16
};

/* The format of frames, made by hapsim_setup_format or hapsim_armed_format. */
typedef struct {
    uint8_t channels;
    uint8_t parts;   /* bits of ARM: values that frames carry behind positions and forces */
    bool long_check; /* CRC-32C instead of CRC-16/DNP */
    uint32_t seed;   /* start value of the check */
} hapsim_format;

/* The most words in a frame of the host. A build that follows lines defines three per channel, one that follows position
 * commands two; one more for a digital word, where that makes more than 16. */
#ifndef HAPSIM_HOST_WORDS
#define HAPSIM_HOST_WORDS HAPSIM_MAX_CHANNELS
#endif
#define HAPSIM_RECENT (HAPSIM_HOST_WORDS > 29 ? 256u : 128u) /* a power of two above the longest frame of the host */

/* The decoder of the host's frames. Once hapsim_take_byte returns true, type, number, argument and payload are
 * valid. */
typedef struct {
    hapsim_format format;
    uint8_t type;
    uint16_t number;
    uint8_t argument;
    int32_t payload[HAPSIM_HOST_WORDS];
    uint32_t accepted, crc_errors, length_errors, form_errors, garbage_bytes;
    uint16_t seen; /* bytes since the last delimiter; any above UINT16_MAX are counted as garbage at once */
    uint8_t at;    /* where the next byte goes in `recent` */
    uint8_t recent[HAPSIM_RECENT];
} hapsim_decoder;

static inline hapsim_format hapsim_setup_format(void) {
    hapsim_format format = {1, 0, false, HAPSIM_SETUP_SEED};
    return format;
}

/* Returns the number of words in the payload of a frame to the host: positions, then velocities, accelerations, hand
 * forces and the inputs, those that the format has. */
static inline uint8_t hapsim_words_to_host(const hapsim_format *format) {
    const uint8_t parts = format->parts;
    const uint8_t each = (uint8_t)(1 + ((parts & HAPSIM_WITH_VELOCITY) != 0) + ((parts & HAPSIM_WITH_ACCELERATION) != 0) +
                                   ((parts & HAPSIM_WITH_FORCE) != 0));
    return (uint8_t)(each * format->channels + ((parts & HAPSIM_WITH_WORDS) != 0));
}

/* Returns the number of words in the payload of a frame of the host: forces, then two words per channel of lines, or one
 * of commands, and the outputs, if the format has them. */
static inline uint8_t hapsim_words_to_device(const hapsim_format *format) {
    const uint8_t parts = format->parts;
    const uint8_t each = (uint8_t)(1 + 2 * ((parts & HAPSIM_WITH_LINE) != 0) + ((parts & HAPSIM_WITH_COMMANDS) != 0));
    return (uint8_t)(each * format->channels + ((parts & HAPSIM_WITH_WORDS) != 0));
}

/* Returns the format between ARM and DISARM of a device with 1 to 16 channels. `parts`: those bits of HAPSIM_PART_BITS
 * that the argument of ARM has. */
static inline hapsim_format hapsim_armed_format(uint8_t channels, uint8_t parts) {
    hapsim_format format = {channels, parts, false, HAPSIM_SCHEMA_HASH};
    format.long_check = hapsim_words_to_host(&format) > HAPSIM_SHORT_CRC_WORDS ||
                        hapsim_words_to_device(&format) > HAPSIM_SHORT_CRC_WORDS;
    if (parts & HAPSIM_WITH_VELOCITY) {
        format.seed ^= HAPSIM_VELOCITY_MARK;
    }
    if (parts & HAPSIM_WITH_ACCELERATION) {
        format.seed ^= HAPSIM_ACCELERATION_MARK;
    }
    if (parts & HAPSIM_WITH_FORCE) {
        format.seed ^= HAPSIM_HAND_FORCE_MARK;
    }
    if (parts & HAPSIM_WITH_LINE) {
        format.seed ^= HAPSIM_LINE_MARK;
    }
    if (parts & HAPSIM_WITH_COMMANDS) {
        format.seed ^= HAPSIM_COMMAND_MARK;
    }
    if (parts & HAPSIM_WITH_WORDS) {
        format.seed ^= HAPSIM_INPUTS_MARK;
    }
    if (!format.long_check) {
        format.seed = (format.seed ^ (format.seed >> 16)) & 0xFFFFu;
    }
    return format;
}

static inline uint8_t hapsim_check_bytes(const hapsim_format *format) {
    return format->long_check ? 5 : 3;
}

/* CRC-16/DNP, four bits at a time. */
static inline uint16_t hapsim_dnp(uint16_t crc, const uint8_t *data, size_t bytes) {
    static const uint16_t table[16] HAPSIM_IN_FLASH = {0x0000, 0xb26b, 0x29af, 0x9bc4, 0x535e, 0xe135, 0x7af1, 0xc89a,
                                                       0xa6bc, 0x14d7, 0x8f13, 0x3d78, 0xf5e2, 0x4789, 0xdc4d, 0x6e26};
    for (size_t i = 0; i < bytes; i++) {
        crc ^= data[i];
        crc = (uint16_t)((crc >> 4) ^ HAPSIM_FLASH_16(&table[crc & 15u]));
        crc = (uint16_t)((crc >> 4) ^ HAPSIM_FLASH_16(&table[crc & 15u]));
    }
    return crc;
}

/* CRC-32C, the same way. */
static inline uint32_t hapsim_castagnoli(uint32_t crc, const uint8_t *data, size_t bytes) {
    static const uint32_t table[16] HAPSIM_IN_FLASH = {
        0x00000000u, 0x105ec76fu, 0x20bd8edeu, 0x30e349b1u, 0x417b1dbcu, 0x5125dad3u, 0x61c69362u, 0x7198540du,
        0x82f63b78u, 0x92a8fc17u, 0xa24bb5a6u, 0xb21572c9u, 0xc38d26c4u, 0xd3d3e1abu, 0xe330a81au, 0xf36e6f75u};
    for (size_t i = 0; i < bytes; i++) {
        crc ^= data[i];
        crc = (crc >> 4) ^ HAPSIM_FLASH_32(&table[crc & 15u]);
        crc = (crc >> 4) ^ HAPSIM_FLASH_32(&table[crc & 15u]);
    }
    return crc;
}

static inline uint32_t hapsim_check(const hapsim_format *format, const uint8_t *data, size_t bytes) {
    if (format->long_check) {
        return hapsim_castagnoli(format->seed, data, bytes) ^ 0xFFFFFFFFu;
    }
    return hapsim_dnp((uint16_t)format->seed, data, bytes) ^ 0xFFFFu;
}

/* Writes the check as it is sent: seven bits per byte, the lowest first, with the high bit set. Returns the number of
 * bytes. */
static inline uint8_t hapsim_put_check(const hapsim_format *format, uint32_t check, uint8_t *out) {
    const uint8_t bytes = hapsim_check_bytes(format);
    for (uint8_t i = 0; i < bytes; i++, check >>= 7) {
        out[i] = (uint8_t)(0x80u | (check & 0x7Fu));
    }
    return bytes;
}

/* Encodes a body of at most 253 bytes in COBS, in place. The body is in buffer[1 .. bytes - 1]. */
static inline void hapsim_stuff(uint8_t *buffer, size_t bytes) {
    size_t last = 0;
    for (size_t i = 1; i < bytes; i++) {
        if (buffer[i] == 0) {
            buffer[last] = (uint8_t)(i - last);
            last = i;
        }
    }
    buffer[last] = (uint8_t)(bytes - last);
}

/* Decodes COBS in place. Returns false if the chain of codes does not end at the end. */
static inline bool hapsim_unstuff(uint8_t *buffer, size_t bytes) {
    size_t at = 0;
    while (at < bytes) {
        size_t following = at + buffer[at];
        if (following == at || following > bytes) {
            return false;
        }
        buffer[at] = 0;
        at = following;
    }
    return true;
}

/* Writes a frame of the device into `out`, which has room for HAPSIM_MAX_FRAME bytes. Returns the frame's length.
 * `payload` has hapsim_words_to_host(format) values: one in the set-up format, at most 61. */
static inline size_t hapsim_write_to_host(const hapsim_format *format, uint8_t *out, uint8_t type, uint16_t number,
                                          const int32_t *payload) {
    const uint8_t words = hapsim_words_to_host(format);
    size_t at = 1;
    out[at++] = (uint8_t)((type << 4) | ((number >> 8) & 0xF));
    out[at++] = (uint8_t)(number & 0xFF);
    for (uint8_t i = 0; i < words; i++) {
        uint32_t word = (uint32_t)payload[i];
        for (uint8_t byte = 0; byte < 4; byte++, word >>= 8) { /* on an AVR a variable shift is a loop */
            out[at++] = (uint8_t)(word & 0xFFu);
        }
    }
    hapsim_stuff(out, at);
    at += hapsim_put_check(format, hapsim_check(format, out, at), out + at);
    out[at++] = 0;
    return at;
}

/* Expects frames of this format from the next byte on. An unfinished frame is discarded; the counters stay. */
static inline void hapsim_use_format(hapsim_decoder *decoder, hapsim_format format) {
    decoder->format = format;
    decoder->seen = 0;
}

static inline void hapsim_decoder_init(hapsim_decoder *decoder) {
    memset(decoder, 0, sizeof *decoder);
    hapsim_use_format(decoder, hapsim_setup_format());
}

/* Reads the fields of a body. Returns false if no host sends this type. */
static inline bool hapsim_read_body(hapsim_decoder *decoder, const uint8_t *body) {
    uint8_t type = (uint8_t)(body[0] >> 4);
    if (type < HAPSIM_DESCRIBE || type > HAPSIM_DISARM) {
        return false;
    }
    decoder->type = type;
    decoder->number = (uint16_t)(((body[0] & 0xFu) << 8) | body[1]);
    decoder->argument = body[2];
    const uint8_t words = hapsim_words_to_device(&decoder->format);
    for (uint8_t i = 0; i < words; i++) {
        const uint8_t *at = body + 3 + 4 * i;
        uint32_t word = at[0] | (uint32_t)at[1] << 8 | (uint32_t)at[2] << 16 | (uint32_t)at[3] << 24;
        memcpy(&decoder->payload[i], &word, sizeof word);
    }
    return true;
}

/* Checks the last bytes before a delimiter, as many as a frame has. Must not be inlined: its registers would be saved
 * for every byte. */
static HAPSIM_APART bool hapsim_accept(hapsim_decoder *decoder) {
    const uint8_t encoded = (uint8_t)(4u + 4u * hapsim_words_to_device(&decoder->format));
    const uint8_t length = (uint8_t)(encoded + hapsim_check_bytes(&decoder->format));
    const uint16_t seen = decoder->seen;
    uint8_t frame[HAPSIM_RECENT];
    decoder->seen = 0;
    if (seen < length) {
        decoder->length_errors += seen > 0; /* two delimiters in a row are no error */
        return false;
    }
    decoder->garbage_bytes += (uint16_t)(seen - length);
    for (uint8_t i = 0; i < length; i++) {
        frame[i] = decoder->recent[(uint8_t)(decoder->at + HAPSIM_RECENT - length + i) % HAPSIM_RECENT];
    }
    uint8_t check[5];
    hapsim_put_check(&decoder->format, hapsim_check(&decoder->format, frame, encoded), check);
    if (memcmp(frame + encoded, check, (size_t)(length - encoded)) != 0) {
        decoder->crc_errors++;
        return false;
    }
    if (!hapsim_unstuff(frame, encoded) || !hapsim_read_body(decoder, frame + 1)) {
        decoder->form_errors++;
        return false;
    }
    decoder->accepted++;
    return true;
}

/* Takes one byte of the host. Returns true if the byte completes a valid frame, which is then in the decoder. */
static inline bool hapsim_take_byte(hapsim_decoder *decoder, uint8_t byte) {
    if (byte == 0) {
        return hapsim_accept(decoder);
    }
    decoder->recent[decoder->at] = byte;
    decoder->at = (uint8_t)((decoder->at + 1u) % HAPSIM_RECENT);
    if (decoder->seen < UINT16_MAX) {
        decoder->seen++;
    } else {
        decoder->garbage_bytes++;
    }
    return false;
}

/* Returns the age of a force: the samples between the current one and the one that the force answers. */
static inline uint16_t hapsim_age(uint32_t sample, uint16_t number) {
    return (uint16_t)((sample - number) % HAPSIM_SAMPLE_MODULUS);
}

/* Returns one half of an f64 register pair. The low word comes first. */
#if defined(__SIZEOF_DOUBLE__) && __SIZEOF_DOUBLE__ != 8
extern uint32_t hapsim_double_is_too_short(void) __attribute__((
    error("double has 4 bytes with this compiler: write the two 32-bit words of the IEEE 754 double instead; "
          "PORTING.md has a table of the usual ones")));
#define hapsim_f64_word(value, high) ((void)(value), (void)(high), hapsim_double_is_too_short())
#else
static inline uint32_t hapsim_f64_word(double value, bool high) {
    uint64_t bits;
    memcpy(&bits, &value, sizeof bits);
    return (uint32_t)(high ? bits >> 32 : bits & 0xFFFFFFFFu);
}
#endif

#endif
