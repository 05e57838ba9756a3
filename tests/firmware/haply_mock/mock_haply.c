/* SPDX-License-Identifier: MIT */
/* A Haply board and its pantograph, from hAPI's frames and from the mechanism alone: nothing of the bridge is in it.
 * `mock_haply LOG [key=value ...]` prints its port's path and serves it until it is killed.
 *
 * LOG: each frame of torques, `nanoseconds of CLOCK_MONOTONIC, torque of port 1, of port 2`, N m.
 * The bridge finds angles and then the end point; here the end point moves, and the angles follow from it.
 */
#define _GNU_SOURCE
#include "terminal.h"

#include <fcntl.h>
#include <math.h>
#include <poll.h>
#include <sched.h>
#include <stdbool.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>
#include <unistd.h>

static struct {
    double proximal, distal, base, counts; /* m; counts a turn, 0: as fine as f32 */
    double mass, inertia, friction;        /* kg at the end point, kg m^2 of each proximal link, N s/m */
    double x, y;                           /* m, where it starts */
    double period;  /* s that pass with each frame of torques; 0: as the machine's clock goes */
    double latency; /* s that an answer takes */
    double swapped; /* 1: arm 0 is on port 2, as of the 2diy; 0: on port 1 */
    double drop, twice, eat, jump, nan, forget, mute, unplug; /* at this frame; 0: never */
} set = {.proximal = 0.07, .distal = 0.09, .base = 0.038, .mass = 0.1, .friction = 0.5, .x = 0.019, .y = 0.1,
         .period = 1e-3, .swapped = 1};

#define KEY(name) {#name, &set.name}
static const struct {
    const char *name;
    double *value;
} keys[] = {KEY(proximal), KEY(distal), KEY(base), KEY(counts), KEY(mass), KEY(inertia), KEY(friction), KEY(x), KEY(y),
            KEY(period), KEY(latency), KEY(swapped), KEY(drop), KEY(twice), KEY(eat), KEY(jump), KEY(nan), KEY(forget), KEY(mute),
            KEY(unplug)};

typedef struct {
    double x[2], v[2];
} motion;

static int port;
static FILE *log_file;
static motion tip;
static double torque[2], beyond[2], resolution[2]; /* of arm 0 and 1; degrees that the encoder reads beyond the angle */
static int64_t moved; /* ns */
static int address = -1; /* of the board that was set up */
static long frames;

static int64_t now_ns(void) {
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return now.tv_sec * 1000000000ll + now.tv_nsec;
}

/* Inverse kinematics: the arm to the left bends left, the other right. */
static double angle_of(int arm, const double x[2]) {
    const double dx = x[0] - arm * set.base, r = hypot(dx, x[1]);
    const double corner = acos((set.proximal * set.proximal + r * r - set.distal * set.distal) / (2 * set.proximal * r));
    return atan2(x[1], dx) + (arm == 0 ? corner : -corner);
}

/* d angle / d end point, by differences: nothing of the bridge's algebra. */
static void gradient(int arm, const double x[2], double along[2]) {
    const double h = 1e-6;
    for (int axis = 0; axis < 2; axis++) {
        double more[2] = {x[0], x[1]}, less[2] = {x[0], x[1]};
        more[axis] += h;
        less[axis] -= h;
        along[axis] = (angle_of(arm, more) - angle_of(arm, less)) / (2 * h);
    }
}

/* Both proximal links and the mass at the end point, by d'Alembert: power in is power into motion and friction. */
static void accelerate(const motion *at, double a[2]) {
    double m[2][2] = {{set.mass, 0}, {0, set.mass}}, f[2];
    for (int axis = 0; axis < 2; axis++) {
        f[axis] = -set.friction * at->v[axis];
    }
    for (int arm = 0; arm < 2; arm++) {
        const double h = 1e-4, ahead[2] = {at->x[0] + h * at->v[0], at->x[1] + h * at->v[1]};
        double g[2], next[2];
        gradient(arm, at->x, g);
        gradient(arm, ahead, next);
        const double turning = set.inertia ? ((next[0] - g[0]) * at->v[0] + (next[1] - g[1]) * at->v[1]) / h : 0;
        for (int i = 0; i < 2; i++) {
            f[i] += g[i] * (torque[arm] - set.inertia * turning);
            for (int j = 0; j < 2; j++) {
                m[i][j] += set.inertia * g[i] * g[j];
            }
        }
    }
    const double area = m[0][0] * m[1][1] - m[0][1] * m[1][0];
    a[0] = (f[0] * m[1][1] - f[1] * m[0][1]) / area;
    a[1] = (f[1] * m[0][0] - f[0] * m[1][0]) / area;
}

static void step(double t) {
    motion at = tip, to = tip;
    double a[2];
    const double part[4] = {t / 2, t / 2, t, 0}, share[4] = {t / 6, t / 3, t / 3, t / 6};
    for (int stage = 0; stage < 4; stage++) {
        accelerate(&at, a);
        for (int axis = 0; axis < 2; axis++) {
            to.x[axis] += share[stage] * at.v[axis];
            to.v[axis] += share[stage] * a[axis];
        }
        for (int axis = 0; axis < 2 && stage < 3; axis++) {
            const double v = at.v[axis];
            at.v[axis] = tip.v[axis] + part[stage] * a[axis];
            at.x[axis] = tip.x[axis] + part[stage] * v;
        }
    }
    if (isfinite(angle_of(0, to.x)) && isfinite(angle_of(1, to.x)) && to.x[1] > 0.03) {
        tip = to;
    } else { /* the frame stops it */
        tip.v[0] = tip.v[1] = 0;
    }
}

static void move_to_now(void) {
    const int64_t now = now_ns();
    double left = set.period > 0 ? set.period : 1e-9 * (double)(now - moved);
    moved = now;
    for (; left > 1e-12; left -= 1e-4) {
        step(fmin(left, 1e-4));
    }
}

/* As Arduino's Stream: a byte, or -1 if none is there; and as readBytes, which waits for a second. */
static int read_byte(int wait_ms) {
    uint8_t byte;
    struct pollfd ready = {port, POLLIN, 0};
    while (poll(&ready, 1, wait_ms) > 0) {
        if (read(port, &byte, 1) == 1) {
            return byte;
        }
    }
    return -1;
}

static void read_floats(float *values, int count) {
    uint8_t *bytes = (uint8_t *)values;
    for (int i = 0; i < 4 * count; i++) {
        const int byte = read_byte(1000);
        if (byte < 0) {
            return;
        }
        bytes[i] = (uint8_t)byte;
    }
}

static int arm_on(int at) {
    return set.swapped ? 1 - at : at;
}

static double degrees_of(int arm) {
    return angle_of(arm, tip.x) * 180 / acos(-1);
}

static void set_up(int id) {
    static bool before;
    float values[4] = {0};
    for (int i = 0; i < 8; i++) {
        (void)read_byte(10); /* motors, 2 directions, encoders, 2 directions, sensors, PWM */
    }
    read_floats(values, 4);
    for (int at = 0; at < 2; at++) {
        const int arm = arm_on(at);
        beyond[arm] = before ? values[2 * at] - degrees_of(arm) : 0; /* at first the arms were at their stops */
        resolution[arm] = values[2 * at + 1];
    }
    before = true;
    address = id;
}

static void answer(int id) {
    uint8_t bytes[10] = {(uint8_t)id};
    size_t count = 1;
    for (int at = 0; at < 2 && id == address; at++, count += 4) {
        const int arm = arm_on(at);
        double degrees = degrees_of(arm) + beyond[arm] + (frames >= set.jump && set.jump > 0 ? 30 : 0);
        if (set.counts > 0) {
            degrees = 360 * floor(degrees / 360 * set.counts) / resolution[arm];
        }
        const float out = frames == set.nan ? NAN : (float)degrees;
        memcpy(&bytes[1 + 4 * at], &out, 4);
    }
    if (frames == set.drop) {
        memmove(&bytes[3], &bytes[4], 5);
        count--;
    } else if (frames == set.twice) {
        memmove(&bytes[4], &bytes[3], 6);
        count++;
    }
    if (!(set.mute > 0 && frames >= set.mute) && write(port, bytes, count) != (ssize_t)count) {
        exit(1);
    }
}

static void put_out(int id) {
    float values[2] = {0};
    if (++frames == set.unplug) {
        exit(0);
    } else if (frames == set.forget) {
        address = -1;
    } else if (frames == set.eat) {
        (void)read_byte(10);
    }
    if (set.latency > 0) { /* half of it on the way to the board */
        usleep((useconds_t)(0.5e6 * set.latency));
    }
    if (id == address) { /* else what follows is read as commands */
        read_floats(values, 2);
        move_to_now();
        for (int at = 0; at < 2; at++) {
            torque[arm_on(at)] = fmax(-0.123, fmin(values[at], 0.123));
        }
        fprintf(log_file, "%lld %.9g %.9g\n", (long long)moved, values[0], values[1]);
        fflush(log_file);
    }
    answer(id);
}

int main(int count, char **words) {
    char path[64];
    for (int i = 2; i < count; i++) {
        const size_t length = strcspn(words[i], "=");
        size_t k = 0;
        while (k < sizeof keys / sizeof *keys && strncmp(words[i], keys[k].name, length) != 0) {
            k++;
        }
        if (k == sizeof keys / sizeof *keys || words[i][length] == 0) {
            fprintf(stderr, "%s: no such key\n", words[i]);
            return 2;
        }
        *keys[k].value = atof(words[i] + length + 1);
    }
    (void)sched_setscheduler(0, SCHED_FIFO, &(struct sched_param){.sched_priority = 2}); /* a board waits for no program */
    log_file = fopen(words[1], "w");
    port = open_terminal(path, sizeof path);
    tip = (motion){{set.x, set.y}, {0, 0}};
    moved = now_ns();
    printf("%s\n", path);
    fflush(stdout);
    for (;;) {
        const int command = read_byte(-1);
        const int id = command >= 0 && command <= 2 ? read_byte(command == 2 ? 10 : 0) : 0;
        if (command == 0) {
            address = -1;
        } else if (command == 1) {
            set_up(id);
        } else if (command == 2) {
            put_out(id);
        }
    }
}
