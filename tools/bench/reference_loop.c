/* The yardstick: hapsim's loop for one scene, configs/first_touch.yaml, as a C program that knows nothing else.
 *
 *     cc -std=c11 -O3 -march=native -ffp-contract=off -pthread -o reference_loop tools/bench/reference_loop.c -lm
 *
 *     reference_loop [options] compute N               N exchanges in memory: ns for each
 *     reference_loop [options] port PATH TICKS PACING  against a device; PACING: lockstep, device, host
 *     reference_loop [options] sleep RATE SECONDS      how late clock_nanosleep wakes it on a grid of RATE Hz
 *
 * Options: --fifo PRIORITY, --timer-slack NS, --dma-latency (holds /dev/cpu_dma_latency at 0), --seconds S (port: stop
 * then; TICKS may be 0), --rate HZ (port: of the scene), --amplitude M (compute: of the motion). One JSON document on
 * standard output.
 *
 * It does what hapsim/loop does for every exchange: frames out of any garbage, the check over the encoded bytes, the
 * spring and its damper, the guards, the limit, the answer, three histograms and a row for a reader. Forces and frames
 * are the same, bit for bit; that is why products and sums are not fused (-ffp-contract=off). What a program for one
 * scene need not ask (how many channels, which damper, whether a parameter is to change) it does not ask.
 */
#ifndef _GNU_SOURCE
#define _GNU_SOURCE /* ppoll */
#endif

#include <errno.h>
#include <fcntl.h>
#include <getopt.h>
#include <inttypes.h>
#include <math.h>
#include <poll.h>
#include <pthread.h>
#include <sched.h>
#include <signal.h>
#include <stdatomic.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/ioctl.h>
#include <sys/prctl.h>
#include <termios.h>
#include <time.h>
#include <unistd.h>

#include "../../firmware_protocol/hapsim_protocol.h"

#define SECOND INT64_C(1000000000)
#define PI 3.14159265358979323846

/* The scene. */
static const double STIFFNESS = 2000.0; /* N/m */
static const double DAMPING = 5.0;      /* N·s/m */
static const double FORCE_LIMIT = 10.0; /* N */

static volatile sig_atomic_t told_to_stop;

static void stop(int signal) {
    (void)signal;
    told_to_stop = 1;
}

static _Noreturn void fail(const char *what) {
    fprintf(stderr, "reference_loop: %s%s%s\n", what, errno ? ": " : "", errno ? strerror(errno) : "");
    exit(3);
}

static inline int64_t now_ns(void) {
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return t.tv_sec * SECOND + t.tv_nsec;
}

/* A deadline already past costs no system call. */
static inline void sleep_until(int64_t deadline) {
    const struct timespec t = {deadline / SECOND, deadline % SECOND};
    while (now_ns() < deadline) {
        const int error = clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &t, NULL);
        if (error != 0 && error != EINTR) {
            return;
        }
    }
}

/* ---- Histograms: 16 bins to the octave, the bin's number read from the leading bits of the value as a double. ---- */

enum { PART_BITS = 4, BINS = 1 + (42 << PART_BITS) };

typedef struct {
    int64_t maximum;
    int64_t counts[BINS];
} histogram;

static inline void note(histogram *h, int64_t value) {
    int64_t i = 0;
    if (value > 0) {
        const double number = (double)value;
        memcpy(&i, &number, sizeof i);
        i = (i >> (52 - PART_BITS)) - ((INT64_C(1023) << PART_BITS) - 1);
        i = i < BINS - 1 ? i : BINS - 1;
        h->maximum = value > h->maximum ? value : h->maximum;
    }
    h->counts[i]++;
}

static double lower_edge(int i) {
    return i == 0 ? 0.0 : ldexp(1.0 + (double)((i - 1) & 15) / 16.0, (i - 1) >> PART_BITS);
}

/* The value that `share` of all do not exceed: the upper end of its bin, so never told too small. */
static double quantile(const histogram *h, double share) {
    int64_t total = 0, so_far = 0;
    for (int i = 0; i < BINS; i++) {
        total += h->counts[i];
    }
    for (int i = 0; i < BINS - 1; i++) {
        so_far += h->counts[i];
        if ((double)so_far >= ceil(share * (double)total)) {
            return fmin(ceil(lower_edge(i + 1)) - 1.0, (double)h->maximum);
        }
    }
    return (double)h->maximum;
}

static void print_histogram(const char *name, const histogram *h) {
    int64_t total = 0;
    for (int i = 0; i < BINS; i++) {
        total += h->counts[i];
    }
    printf(", \"%s\": ", name);
    if (total == 0) {
        printf("null");
        return;
    }
    printf("{\"count\": %" PRId64 ", \"p50\": %.0f, \"p99\": %.0f, \"p999\": %.0f, \"max\": %" PRId64 "}", total,
           quantile(h, 0.5), quantile(h, 0.99), quantile(h, 0.999), h->maximum);
}

/* ---- The check, eight bytes at a time: tables[k][b] is what byte b does to the register k bytes later. ---- */

enum { CHANNELS = 1, TO_HOST = 3 + 4 * CHANNELS, TO_DEVICE = TO_HOST + 1, CHECK = 3, FRAME = TO_HOST + CHECK };

static uint16_t tables[8][256];

static void make_tables(void) {
    for (unsigned byte = 0; byte < 256; byte++) {
        unsigned crc = byte;
        for (int bit = 0; bit < 8; bit++) {
            crc = (crc >> 1) ^ (crc & 1 ? 0xa6bcu : 0u);
        }
        tables[0][byte] = (uint16_t)crc;
    }
    for (int k = 1; k < 8; k++) {
        for (unsigned byte = 0; byte < 256; byte++) {
            const uint16_t before = tables[k - 1][byte];
            tables[k][byte] = (uint16_t)((before >> 8) ^ tables[0][before & 0xff]);
        }
    }
}

/* CRC-16/DNP of 2 to 8 bytes. The lookups do not wait for each other. */
static inline uint32_t check_of(const uint8_t *data, int bytes, uint32_t seed) {
    uint32_t crc = tables[bytes - 1][data[0] ^ (seed & 0xff)] ^ tables[bytes - 2][data[1] ^ (seed >> 8)];
    for (int i = 2; i < bytes; i++) {
        crc ^= tables[bytes - 1 - i][data[i]];
    }
    return crc ^ 0xffff;
}

/* The three bytes of a check as they are sent, the first in bits 7 to 0. */
static inline uint32_t seven_bits_each(uint32_t check) {
    return 0x808080u | (check & 0x7fu) | (check & 0x3f80u) << 1 | (check & 0xc000u) << 2;
}

/* ---- Frames ---- */

/* Writes a frame of the host, delimiter included; returns its bytes. */
static inline int write_frame(uint8_t *out, uint32_t seed, unsigned type, unsigned number, unsigned argument,
                              int32_t word) {
    out[1] = (uint8_t)(type << 4 | (number >> 8 & 0xf));
    out[2] = (uint8_t)number;
    out[3] = (uint8_t)argument;
    memcpy(out + 4, &word, sizeof word); /* this machine is little endian, as the wire */
    hapsim_stuff(out, TO_DEVICE);
    const uint32_t check = seven_bits_each(check_of(out, TO_DEVICE, seed)); /* its fourth byte is the delimiter */
    memcpy(out + TO_DEVICE, &check, sizeof check);
    return TO_DEVICE + CHECK + 1;
}

/* Bytes that arrived, and the last frame that was found in them. */
typedef struct {
    size_t start, stop; /* what is not yet looked at */
    size_t skipped;     /* bytes since the last delimiter that are no longer kept */
    uint32_t seed;
    unsigned type, number;
    int32_t word;
    int64_t accepted, crc_errors, length_errors, form_errors, garbage_bytes;
    uint8_t bytes[8192];
} inbox;

/* Forgets the beginning of an unfinished frame. */
static void use_seed(inbox *in, uint32_t seed) {
    in->seed = seed;
    in->skipped = 0;
}

/* Whether the frame that ends just before `end` is one; it is then in the inbox. */
static inline bool accept_frame(inbox *in, const uint8_t *end) {
    const uint8_t *frame = end - FRAME;
    uint8_t body[TO_HOST];
    uint32_t sent = 0;
    memcpy(&sent, frame + TO_HOST, CHECK);
    if (sent != seven_bits_each(check_of(frame, TO_HOST, in->seed))) {
        in->crc_errors++;
        return false;
    }
    memcpy(body, frame, TO_HOST);
    const unsigned type = hapsim_unstuff(body, TO_HOST) ? body[1] >> 4 : 0;
    if (type < HAPSIM_DESCRIPTION || type > HAPSIM_STATUS) {
        in->form_errors++;
        return false;
    }
    in->type = type;
    in->number = (body[1] & 0xfu) << 8 | body[2];
    memcpy(&in->word, body + 3, sizeof in->word);
    in->accepted++;
    return true;
}

/* Whether the bytes at hand hold a whole frame. A frame is the last FRAME bytes before a delimiter; what stands before
 * them is garbage. */
static inline bool next_frame(inbox *in) {
    while (in->start < in->stop) {
        const uint8_t *from = in->bytes + in->start;
        const uint8_t *delimiter = memchr(from, 0, in->stop - in->start);
        if (delimiter == NULL) {
            return false;
        }
        const size_t at_hand = (size_t)(delimiter - from), seen = at_hand + in->skipped;
        in->start += at_hand + 1;
        in->skipped = 0;
        if (seen < FRAME) {
            in->length_errors += seen > 0;
            continue;
        }
        in->garbage_bytes += (int64_t)(seen - FRAME);
        if (accept_frame(in, delimiter)) {
            return true;
        }
    }
    return false;
}

/* Room for what arrives next: of an unfinished frame no more is kept than a frame has. */
static inline void make_room(inbox *in) {
    size_t kept = in->stop - in->start;
    if (kept > FRAME) {
        in->skipped += kept - FRAME;
        in->start = in->stop - FRAME;
        kept = FRAME;
    }
    if (kept) {
        memmove(in->bytes, in->bytes + in->start, kept);
    }
    in->start = 0;
    in->stop = kept;
}

/* ---- The ring of rows: one writer, the loop; one reader, which copies them out and keeps them. ---- */

enum { HELD = 1, UNSENT = 2, LIMITED = 4, BRIDGED = 8, OFF_GRID = 16 };
enum { ROWS = 1 << 16 };

typedef struct {
    int64_t sample, time;
    double asked; /* N: the scene's force before limit and rounding */
    int32_t position, force;
    uint8_t flags;
} row;

typedef struct {
    _Atomic uint64_t head, tail;
    uint64_t unpublished, dropped;
    bool waits; /* the loop returns when it is half full, instead of dropping rows when it is full */
    row rows[ROWS];
} ring;

static inline void push(ring *r, row new) {
    const uint64_t at = atomic_load_explicit(&r->head, memory_order_relaxed) + r->unpublished;
    if (at - atomic_load_explicit(&r->tail, memory_order_acquire) >= ROWS) {
        r->dropped++;
        return;
    }
    r->rows[at % ROWS] = new;
    r->unpublished++;
}

/* The row pushed last is not yet seen by the reader. */
static inline void mark_last(ring *r, uint8_t flag) {
    if (r->unpublished) {
        r->rows[(atomic_load_explicit(&r->head, memory_order_relaxed) + r->unpublished - 1) % ROWS].flags |= flag;
    }
}

static inline void publish(ring *r) {
    const uint64_t head = atomic_load_explicit(&r->head, memory_order_relaxed);
    atomic_store_explicit(&r->head, head + r->unpublished, memory_order_release);
    r->unpublished = 0;
}

static inline bool wants_reading(const ring *r) {
    return r->waits &&
           atomic_load_explicit(&r->head, memory_order_relaxed) -
                   atomic_load_explicit(&r->tail, memory_order_relaxed) >
               ROWS / 2;
}

typedef struct {
    ring *from;
    row *rows;
    size_t count, room;
    atomic_bool done;
} record;

static void collect(record *kept) {
    const uint64_t head = atomic_load_explicit(&kept->from->head, memory_order_acquire);
    uint64_t tail = atomic_load_explicit(&kept->from->tail, memory_order_relaxed);
    if (kept->count + (head - tail) > kept->room) {
        kept->room = 2 * (kept->count + (head - tail)) + ROWS;
        kept->rows = realloc(kept->rows, kept->room * sizeof *kept->rows);
        if (kept->rows == NULL) {
            fail("no memory for the record");
        }
    }
    for (; tail < head; tail++) {
        kept->rows[kept->count++] = kept->from->rows[tail % ROWS];
    }
    atomic_store_explicit(&kept->from->tail, tail, memory_order_release);
}

/* The reader beside a loop in real time. */
static void *keep_collecting(void *argument) {
    record *kept = argument;
    const struct timespec look = {0, 50000000};
    while (!atomic_load(&kept->done)) {
        collect(kept);
        nanosleep(&look, NULL);
    }
    return NULL;
}

/* ---- The transport: a descriptor, or frames in memory. ---- */

enum { FRAMES = 4096 };
enum { TIMED_OUT = 0, GONE = -1 };

typedef struct {
    int descriptor; /* negative: in memory */
    unsigned received, sent;
    uint8_t (*frames)[FRAME + 1];
    uint8_t (*answers)[TO_DEVICE + CHECK + 1];
} transport;

/* Bytes into in->bytes[in->stop], after waiting for them for `timeout` ns at most. */
static inline int receive(transport *l, inbox *in, int64_t timeout) {
    make_room(in);
    if (l->descriptor < 0) {
        memcpy(in->bytes + in->stop, l->frames[l->received++ % FRAMES], FRAME + 1);
        in->stop += FRAME + 1;
        return FRAME + 1;
    }
    struct pollfd wait = {.fd = l->descriptor, .events = POLLIN};
    timeout = timeout > 0 ? timeout : 0;
    const struct timespec limit = {timeout / SECOND, timeout % SECOND};
    const int ready = ppoll(&wait, 1, &limit, NULL);
    if (ready <= 0) {
        return ready == 0 || errno == EINTR ? TIMED_OUT : GONE;
    }
    if (!(wait.revents & POLLIN)) {
        return GONE;
    }
    const ssize_t count = read(l->descriptor, in->bytes + in->stop, sizeof in->bytes - in->stop);
    if (count > 0) {
        in->stop += (size_t)count;
        return (int)count;
    }
    return count < 0 && (errno == EINTR || errno == EAGAIN) ? TIMED_OUT : GONE;
}

static inline int send_frame(transport *l, const uint8_t *frame, int bytes) {
    if (l->descriptor < 0) {
        memcpy(l->answers[l->sent++ % FRAMES], frame, (size_t)bytes);
        return 0;
    }
    for (int at = 0; at < bytes;) {
        const ssize_t count = write(l->descriptor, frame + at, (size_t)(bytes - at));
        if (count > 0) {
            at += (int)count;
        } else if (count < 0 && errno == EAGAIN) {
            struct pollfd wait = {.fd = l->descriptor, .events = POLLOUT};
            if (poll(&wait, 1, 100) <= 0) {
                return GONE;
            }
        } else if (count == 0 || errno != EINTR) {
            return GONE;
        }
    }
    return 0;
}

/* ---- The loop ---- */

enum { DEVICE_CLOCK, HOST_CLOCK, NO_CLOCK };
enum { DONE, STOPPED, RING_FULL, SILENT, AWAY, NOT_FINITE, DEVICE_STOPPED };
enum { NOTHING = 0, HEARD = 1, FAULT = -3, BAD_FORCE = -4 };
static const char *const ENDINGS[] = {"done", "stopped", "", "silent", "gone", "force not finite", "device stopped"};

typedef struct {
    transport transport;
    inbox in;
    ring *ring;
    int clock;
    int64_t ticks_to_run, period, silence, stop_at;
    unsigned time_to_live;
    uint32_t seed;
    double damping_per_sample, position_scale, force_scale, force_limit;
    double position, before; /* m */
    int32_t force_counts;
    int64_t sample, ticks, late, lost, stale, limited, age, fault, first, newest, due;
    histogram lateness, exchange, ages;
} loop;

/* Finite, within the limit and rounded; the row's flags, or BAD_FORCE. */
static inline int set_force(loop *l, double asked) {
    if (!isfinite(asked)) {
        l->force_counts = 0;
        return BAD_FORCE;
    }
    double force = asked;
    const bool over = fabs(force) > l->force_limit;
    if (over) {
        force = copysign(l->force_limit, force);
        l->limited++;
    }
    const double counts = rint(force / l->force_scale); /* the limit keeps them within 32 bits */
    l->force_counts = (int32_t)counts;
    return over ? LIMITED : 0;
}

/* How much later a position came than the earliest ones of late: the grid of expected arrivals moves to every earlier
 * arrival, and a little after every later one. */
static inline void note_lateness(loop *l, int64_t now, int64_t gap) {
    const int64_t late = now - l->due;
    note(&l->lateness, late);
    l->due += (late < 0 ? late : late >> 4) + gap * l->period;
}

static inline uint8_t timing_flags(loop *l, int64_t now, int64_t gap) {
    uint8_t flags = 0;
    const bool held = l->in.type == HAPSIM_POSITION_HELD;
    l->late += held;
    l->age = held ? l->age + 1 : 1;
    note(&l->ages, l->age);
    if (gap > 1) {
        l->lost += gap - 1;
        flags |= BRIDGED;
    }
    if (l->clock == DEVICE_CLOCK) {
        note_lateness(l, now, gap);
    } else if (l->clock == HOST_CLOCK && l->ticks > 0 && llabs(now - l->newest - l->period) > l->period / 8) {
        flags |= OFF_GRID;
    }
    return held ? flags | HELD : flags;
}

static inline int take_position(loop *l, int64_t now) {
    const double measured = l->in.word * l->position_scale;
    if (l->ticks == 0) {
        l->position = measured;
        l->sample = (int64_t)l->in.number - 1;
        l->first = l->due = now;
    }
    const int64_t gap = (l->in.number - l->sample) & 4095;
    uint8_t flags = timing_flags(l, now, gap);
    l->before = l->position;
    if (gap > 1) { /* along a straight line past the positions that never arrived */
        l->before += (measured - l->position) * (double)(gap - 1) / (double)gap;
    }
    l->position = measured;
    const double asked = 0.0 - (STIFFNESS * l->position + l->damping_per_sample * (l->position - l->before));
    const int guarded = set_force(l, asked);
    flags |= guarded > 0 ? (uint8_t)guarded : 0;
    l->sample += gap;
    l->newest = now;
    push(l->ring, (row){l->sample, now, asked, l->in.word, l->force_counts, flags});
    l->ticks++;
    return guarded < 0 ? BAD_FORCE : HEARD;
}

/* Newer than the last; one that comes twice, or after a newer one, is counted and passed over. */
static inline bool is_news(loop *l) {
    if (l->in.type != HAPSIM_POSITION && l->in.type != HAPSIM_POSITION_HELD) {
        return false;
    }
    const int64_t gap = (l->in.number - l->sample) & 4095;
    if (l->ticks > 0 && (gap == 0 || gap >= 2048)) {
        l->stale++;
        return false;
    }
    return true;
}

/* Takes every position at hand, which arrived at `now`; only the newest is answered. */
static inline int digest(loop *l, int64_t now) {
    int heard = NOTHING;
    while (next_frame(&l->in)) {
        if (l->in.type == HAPSIM_STATUS) {
            l->fault = l->in.word >> 8 & 0xff;
            return FAULT;
        }
        if (!is_news(l)) {
            continue;
        }
        if (heard) {
            l->stale++;
            mark_last(l->ring, UNSENT);
        }
        if (take_position(l, now) == BAD_FORCE) {
            return BAD_FORCE;
        }
        heard = HEARD;
    }
    return heard;
}

/* Waits for a position from `now` on: HEARD, or TIMED_OUT, GONE, FAULT, BAD_FORCE. */
static inline int take_newest_position(loop *l, int64_t now, int64_t timeout) {
    const int64_t give_up = now + timeout;
    int code = digest(l, now);
    while (code == NOTHING) {
        const bool last_look = now >= give_up;
        const int count = receive(&l->transport, &l->in, give_up - now);
        now = now_ns();
        if (count < 0) {
            return count;
        }
        code = digest(l, now);
        if (last_look && code == NOTHING) {
            return TIMED_OUT;
        }
    }
    return code;
}

/* Sends the force that answers the newest position, then shows the tick to the reader; when it had left, or GONE. */
static inline int64_t answer(loop *l) {
    uint8_t out[16];
    const unsigned number = (unsigned)l->sample & 4095u;
    const int bytes = write_frame(out, l->seed, HAPSIM_FORCE, number, l->time_to_live, l->force_counts);
    if (send_frame(&l->transport, out, bytes) != 0) {
        return GONE;
    }
    const int64_t now = now_ns();
    if (l->clock != HOST_CLOCK) {
        note(&l->exchange, now - l->newest);
    }
    publish(l->ring);
    return now;
}

/* Zero force, at once: the last frame, whatever ended the loop. */
static int release_device(loop *l, int ending) {
    uint8_t out[16];
    l->force_counts = 0;
    send_frame(&l->transport, out, write_frame(out, l->seed, HAPSIM_DISARM, 0, 0, 0));
    publish(l->ring);
    return ending;
}

static int ending_of(int code) {
    return code == FAULT ? DEVICE_STOPPED : code == BAD_FORCE ? NOT_FINITE : code == TIMED_OUT ? SILENT : AWAY;
}

/* DONE or STOPPED where it is time to end, negative where not. */
static inline int time_to_end(const loop *l) {
    if (told_to_stop || l->newest >= l->stop_at) {
        return STOPPED;
    }
    return l->ticks_to_run > 0 && l->ticks >= l->ticks_to_run ? DONE : -1;
}

/* Answers every position until something ends it. RING_FULL alone leaves the device armed. */
static int run_paced_by_device(loop *l) {
    int64_t now = now_ns();
    for (;;) {
        const int ending = time_to_end(l);
        if (ending >= 0) {
            return release_device(l, ending);
        }
        if (wants_reading(l->ring)) {
            return RING_FULL;
        }
        const int code = take_newest_position(l, now, l->silence);
        if (code != HEARD) {
            return release_device(l, ending_of(code));
        }
        now = answer(l);
        if (now < 0) {
            return release_device(l, AWAY);
        }
    }
}

/* The next point of the grid, or of a new grid where this tick came a whole period late. */
static inline int64_t next_due(loop *l, int64_t due) {
    const int64_t now = now_ns();
    if (now < due + l->period) {
        return due + l->period;
    }
    l->late++;
    return now + l->period;
}

/* Once a period the force out and the next position in. */
static int run_paced_by_host(loop *l) {
    int code = take_newest_position(l, now_ns(), l->silence);
    int64_t due = now_ns() + l->period;
    while (code == HEARD || code == TIMED_OUT) {
        if (l->ticks == 0 || now_ns() - l->newest > l->silence) {
            break;
        }
        const int ending = time_to_end(l);
        if (ending >= 0) {
            return release_device(l, ending);
        }
        sleep_until(due);
        const int64_t woken = now_ns();
        note(&l->lateness, woken - due);
        due = next_due(l, due);
        code = take_newest_position(l, woken, 0); /* one that came after its tick was over */
        if (code == HEARD || code == TIMED_OUT) {
            const int64_t sent = answer(l);
            code = sent < 0 ? GONE : take_newest_position(l, sent, due - sent);
            if (code == HEARD) {
                note(&l->exchange, l->newest - sent);
            }
        }
    }
    return release_device(l, ending_of(code));
}

/* ---- The conversation before and after ---- */

static const int64_t ANSWER_NS = 250000000, LET_GO_NS = 100000000;

static void say(loop *l, uint32_t seed, unsigned type, unsigned number, unsigned argument, uint32_t word) {
    uint8_t out[16];
    if (send_frame(&l->transport, out, write_frame(out, seed, type, number, argument, (int32_t)word)) != 0) {
        fail("the port does not take what is written to it");
    }
}

/* Whether a frame of this type and number (negative: any) comes within `timeout`; it is then in the inbox. */
static bool hear(loop *l, unsigned type, int number, int64_t timeout) {
    const int64_t give_up = now_ns() + timeout;
    for (int64_t left = timeout; left > 0; left = give_up - now_ns()) {
        while (next_frame(&l->in)) {
            if (l->in.type == type && (number < 0 || (unsigned)number == l->in.number)) {
                return true;
            }
        }
        if (receive(&l->transport, &l->in, left) < 0) {
            fail("the device is gone");
        }
    }
    return false;
}

static uint32_t ask(loop *l, int number) {
    for (int attempt = 0; attempt < 12; attempt++) {
        if (attempt == 2) { /* it may still be armed, by a host that died */
            say(l, l->seed, HAPSIM_DISARM, 0, 0, 0);
        }
        say(l, HAPSIM_SETUP_SEED, HAPSIM_DESCRIBE, (unsigned)number, 0, 0);
        if (hear(l, HAPSIM_DESCRIPTION, number, ANSWER_NS)) {
            return (uint32_t)l->in.word;
        }
    }
    errno = 0;
    fail("the device does not answer");
}

static double ask_double(loop *l, int number) {
    const uint64_t low = ask(l, number), bits = (uint64_t)ask(l, number + 1) << 32 | low;
    double value = 0.0;
    memcpy(&value, &bits, sizeof value);
    return value;
}

/* What the device says of itself; the limit in whole counts, as hapsim takes it. */
static void describe(loop *l, double rate) {
    errno = 0;
    if (ask(l, HAPSIM_REG_VERSION) != HAPSIM_VERSION || ask(l, HAPSIM_REG_SCHEMA) != HAPSIM_SCHEMA_HASH) {
        fail("the device speaks another protocol");
    }
    if (ask(l, HAPSIM_REG_CHANNELS) != CHANNELS || fabs(ask_double(l, HAPSIM_REG_RATE) / rate - 1.0) > 1e-6) {
        fail("the device has another number of channels or another rate");
    }
    l->position_scale = ask_double(l, HAPSIM_REG_CHANNEL + HAPSIM_REG_POSITION_SCALE);
    l->force_scale = ask_double(l, HAPSIM_REG_CHANNEL + HAPSIM_REG_FORCE_SCALE);
    const double limit = fmin(ask_double(l, HAPSIM_REG_CHANNEL + HAPSIM_REG_FORCE_LIMIT), FORCE_LIMIT);
    l->force_limit = fmin(floor(limit / l->force_scale * (1.0 + 1e-12)), 2147483647.0) * l->force_scale;
}

static void arm(loop *l, unsigned pacing, double rate) {
    const double watchdog = fmin(fmax(rint(0.1 * rate), 10.0), ask(l, HAPSIM_REG_MAX_WATCHDOG));
    for (int attempt = 0; attempt < 4; attempt++) {
        say(l, HAPSIM_SETUP_SEED, HAPSIM_ARM, (unsigned)watchdog, pacing, HAPSIM_SCHEMA_HASH);
        if (hear(l, HAPSIM_STATUS, 0, ANSWER_NS) && (l->in.word & 0xff) == HAPSIM_ARMED) {
            use_seed(&l->in, l->seed);
            return;
        }
    }
    errno = 0;
    fail("the device does not arm");
}

/* In its own format to a device that is still armed, in the set-up format to one that released by itself. */
static void disarm(loop *l) {
    use_seed(&l->in, HAPSIM_SETUP_SEED);
    for (int attempt = 0; attempt < 3; attempt++) {
        say(l, l->seed, HAPSIM_DISARM, 0, 0, 0);
        if (hear(l, HAPSIM_STATUS, -1, LET_GO_NS)) {
            return;
        }
        say(l, HAPSIM_SETUP_SEED, HAPSIM_DISARM, 0, 0, 0);
        if (hear(l, HAPSIM_STATUS, -1, LET_GO_NS)) {
            return;
        }
    }
}

static int open_raw(const char *path) {
    const int descriptor = open(path, O_RDWR | O_NOCTTY | O_NONBLOCK);
    struct termios attributes;
    if (descriptor < 0 || tcgetattr(descriptor, &attributes) != 0) {
        fail(path);
    }
    cfmakeraw(&attributes);
    attributes.c_cflag |= CLOCAL | CREAD;
    attributes.c_cc[VMIN] = 1; /* "nothing there" is then EAGAIN, and only a hang-up reads as empty */
    attributes.c_cc[VTIME] = 0;
    cfsetspeed(&attributes, B2000000);
    if (tcsetattr(descriptor, TCSANOW, &attributes) != 0) {
        fail(path);
    }
    ioctl(descriptor, TIOCEXCL);
    return descriptor;
}

/* ---- Modes ---- */

typedef struct {
    int fifo;
    long slack;
    bool dma_latency;
    double seconds, rate, amplitude;
} options;

/* The CRC-32 of zlib, for comparing what was sent with what another program sent. */
static uint32_t crc32_of(uint32_t crc, const void *data, size_t bytes) {
    const uint8_t *at = data;
    crc = ~crc;
    for (size_t i = 0; i < bytes; i++) {
        crc ^= at[i];
        for (int bit = 0; bit < 8; bit++) {
            crc = (crc >> 1) ^ (crc & 1 ? 0xedb88320u : 0u);
        }
    }
    return ~crc;
}

static loop *new_loop(const options *o) {
    loop *l = calloc(1, sizeof *l);
    ring *r = calloc(1, sizeof *r);
    if (l == NULL || r == NULL) {
        fail("no memory");
    }
    memset(r, 0, sizeof *r); /* every page is there before the first tick */
    l->ring = r;
    l->seed = hapsim_armed_format(CHANNELS, 0).seed;
    l->stop_at = INT64_MAX;
    l->damping_per_sample = DAMPING * o->rate;
    l->period = llrint(1e9 / o->rate);
    l->time_to_live = (unsigned)fmin(fmax(rint(0.02 * o->rate), 2.0), 255.0);
    return l;
}

/* The device's half, from the protocol's own header: a period of the motion is 64 samples and a bit, so that no two of
 * the frames are alike. */
static void encode_frames(uint8_t (*frames)[FRAME + 1], double amplitude) {
    const hapsim_format armed = hapsim_armed_format(CHANNELS, 0);
    for (int i = 0; i < FRAMES; i++) {
        const int32_t counts = (int32_t)floor(amplitude * 1e9 * sin(2.0 * PI * 63.0 * i / FRAMES) + 0.5);
        uint8_t frame[HAPSIM_MAX_FRAME];
        hapsim_write_to_host(&armed, frame, HAPSIM_POSITION, (uint16_t)i, &counts);
        memcpy(frames[i], frame, FRAME + 1);
    }
}

static void compute(const options *o, int64_t exchanges) {
    static uint8_t frames[FRAMES][FRAME + 1], answers[FRAMES][TO_DEVICE + CHECK + 1];
    loop *l = new_loop(o);
    encode_frames(frames, o->amplitude);
    l->transport = (transport){.descriptor = -1, .frames = frames, .answers = answers};
    l->clock = DEVICE_CLOCK;
    l->period = 0; /* so that every position is a little late, and lateness is counted like any number */
    l->silence = SECOND;
    l->position_scale = 1e-9;
    l->force_scale = FORCE_LIMIT / 2147483648.0;
    l->force_limit = 2147483647.0 * l->force_scale;
    use_seed(&l->in, l->seed);
    l->ring->waits = true;
    l->ticks_to_run = exchanges;
    const int64_t start = now_ns();
    while (run_paced_by_device(l) == RING_FULL) {
        atomic_store(&l->ring->tail, atomic_load(&l->ring->head));
    }
    const int64_t taken = now_ns() - start;
    printf("{\"mode\": \"compute\", \"exchanges\": %" PRId64 ", \"ns_per_exchange\": %.3f", l->ticks,
           (double)taken / (double)exchanges);
    printf(", \"answers_crc32\": %u, \"frames_crc32\": %u, \"limited\": %" PRId64 "}\n",
           crc32_of(0, answers, sizeof answers), crc32_of(0, frames, sizeof frames), l->limited);
}

/* Runs until something ends it, a reader beside it that keeps every row; in virtual time the loop itself waits for the
 * reader. */
static int run_and_record(loop *l, record *kept) {
    pthread_t reader;
    kept->from = l->ring;
    const bool beside = l->clock != NO_CLOCK;
    if (beside && pthread_create(&reader, NULL, keep_collecting, kept) != 0) {
        fail("no thread for the reader");
    }
    int ending = RING_FULL;
    while (ending == RING_FULL) {
        ending = l->clock == HOST_CLOCK ? run_paced_by_host(l) : run_paced_by_device(l);
        if (ending == RING_FULL) {
            collect(kept);
        }
    }
    if (beside) {
        atomic_store(&kept->done, true);
        pthread_join(reader, NULL);
    }
    collect(kept);
    return ending;
}

static void print_run(const loop *l, const record *kept, int ending) {
    const double seconds = (double)(l->newest - l->first) * 1e-9;
    uint32_t forces = 0, positions = 0;
    for (size_t i = 0; i < kept->count; i++) {
        forces = crc32_of(forces, &kept->rows[i].force, sizeof(int32_t));
        positions = crc32_of(positions, &kept->rows[i].position, sizeof(int32_t));
    }
    printf("{\"mode\": \"port\", \"ending\": \"%s\", \"fault\": %" PRId64 ", \"ticks\": %" PRId64 ", \"seconds\": %.9f",
           ENDINGS[ending], l->fault, l->ticks, seconds);
    printf(", \"exchanges_per_second\": %.3f, \"late\": %" PRId64 ", \"lost\": %" PRId64 ", \"stale\": %" PRId64,
           seconds > 0 ? (double)(l->ticks - 1) / seconds : 0.0, l->late, l->lost, l->stale);
    printf(", \"limited\": %" PRId64 ", \"refused\": %" PRId64 ", \"dropped_rows\": %" PRIu64 ", \"rows\": %zu",
           l->limited, l->in.crc_errors + l->in.length_errors + l->in.form_errors, l->ring->dropped, kept->count);
    print_histogram("exchange_ns", &l->exchange);
    print_histogram("lateness_ns", &l->lateness);
    print_histogram("age_samples", &l->ages);
    printf(", \"forces_crc32\": %u, \"positions_crc32\": %u}\n", forces, positions);
}

static void port(const options *o, const char *path, int64_t ticks, const char *pacing) {
    static const char *const names[] = {"device", "host", "lockstep"};
    static record kept;
    loop *l = new_loop(o);
    unsigned which = 0;
    while (which < 3 && strcmp(pacing, names[which]) != 0) {
        which++;
    }
    if (which == 3) {
        fail("PACING is lockstep, device or host");
    }
    l->clock = which == HAPSIM_LOCKSTEP ? NO_CLOCK : which == HAPSIM_PACED_BY_HOST ? HOST_CLOCK : DEVICE_CLOCK;
    l->silence = l->clock == NO_CLOCK ? 5 * SECOND : llrint(1e9 * fmax(0.25, 20.0 / o->rate));
    l->ring->waits = l->clock == NO_CLOCK;
    l->ticks_to_run = ticks;
    l->transport.descriptor = open_raw(path);
    use_seed(&l->in, HAPSIM_SETUP_SEED);
    describe(l, o->rate);
    arm(l, which, o->rate);
    if (o->seconds > 0) {
        l->stop_at = now_ns() + llrint(1e9 * o->seconds);
    }
    const int ending = run_and_record(l, &kept);
    disarm(l);
    close(l->transport.descriptor);
    print_run(l, &kept, ending);
}

static void measure_sleep(double rate, double seconds) {
    static histogram lateness;
    const int64_t period = llrint(1e9 / rate), end = now_ns() + llrint(1e9 * seconds);
    for (int64_t due = now_ns() + period; due < end && !told_to_stop;) {
        sleep_until(due);
        const int64_t now = now_ns();
        note(&lateness, now - due);
        due = now < due + period ? due + period : now + period; /* a whole period late: the grid begins anew */
    }
    printf("{\"mode\": \"sleep\", \"rate_hz\": %g", rate);
    print_histogram("lateness_ns", &lateness);
    printf("}\n");
}

/* What was asked for, or nothing: a measurement under other conditions than it states is none. */
static void take_conditions(const options *o) {
    if (o->slack > 0 && prctl(PR_SET_TIMERSLACK, o->slack, 0, 0, 0) != 0) {
        fail("timer slack");
    }
    if (o->dma_latency) {
        const int32_t none = 0;
        const int descriptor = open("/dev/cpu_dma_latency", O_RDWR); /* held until the program ends */
        if (descriptor < 0 || write(descriptor, &none, sizeof none) != sizeof none) {
            fail("/dev/cpu_dma_latency");
        }
    }
    const struct sched_param priority = {.sched_priority = o->fifo};
    if (o->fifo > 0 && sched_setscheduler(0, SCHED_FIFO, &priority) != 0) {
        fail("SCHED_FIFO");
    }
}

static options read_options(int count, char **words) {
    static const struct option names[] = {
        {"fifo", required_argument, NULL, 'f'},        {"timer-slack", required_argument, NULL, 't'},
        {"dma-latency", no_argument, NULL, 'd'},       {"seconds", required_argument, NULL, 's'},
        {"rate", required_argument, NULL, 'r'},        {"amplitude", required_argument, NULL, 'a'},
        {NULL, 0, NULL, 0}};
    options o = {.rate = 1000.0, .amplitude = 0.004};
    for (int c = 0; (c = getopt_long(count, words, "", names, NULL)) != -1;) {
        switch (c) {
        case 'f': o.fifo = atoi(optarg); break;
        case 't': o.slack = atol(optarg); break;
        case 'd': o.dma_latency = true; break;
        case 's': o.seconds = atof(optarg); break;
        case 'r': o.rate = atof(optarg); break;
        case 'a': o.amplitude = atof(optarg); break;
        default: exit(2);
        }
    }
    return o;
}

int main(int count, char **words) {
    const options o = read_options(count, words);
    const int left = count - optind;
    char **rest = words + optind;
    struct sigaction action = {.sa_handler = stop};
    sigaction(SIGINT, &action, NULL);
    sigaction(SIGTERM, &action, NULL);
    make_tables();
    take_conditions(&o);
    if (left == 2 && strcmp(rest[0], "compute") == 0) {
        compute(&o, (int64_t)atof(rest[1]));
    } else if (left == 4 && strcmp(rest[0], "port") == 0) {
        port(&o, rest[1], (int64_t)atof(rest[2]), rest[3]);
    } else if (left == 3 && strcmp(rest[0], "sleep") == 0) {
        measure_sleep(atof(rest[1]), atof(rest[2]));
    } else {
        fprintf(stderr, "reference_loop compute N | port PATH TICKS PACING | sleep RATE SECONDS\n");
        return 2;
    }
    return 0;
}
