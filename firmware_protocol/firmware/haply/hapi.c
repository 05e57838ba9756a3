/* SPDX-License-Identifier: MIT */
#define _GNU_SOURCE
#include "hapi.h"

#include <errno.h>
#include <fcntl.h>
#include <math.h>
#include <poll.h>
#include <stdio.h>
#include <string.h>
#include <sys/file.h>
#include <sys/ioctl.h>
#include <termios.h>
#include <unistd.h>

#define ID 5 /* any value that is no command; hAPI's own examples use 5 */
#define RESET 0
#define SET_UP 1
#define TORQUES 2
#define FRAME 10
#define ANSWER 9
#ifndef HAPI_ANSWER_MS
#define HAPI_ANSWER_MS 20 /* USB takes 1 to 2; a force lives about as long as this without the next */
#endif
#define SILENCE_MS 20

/* 3 is no command of hAPI, so the board skips it where a command is due. Four of these bytes are a torque of 3.9e-37.
 * After the first bytes of a torque, they leave less than 1e-36. So they complete a frame that lost bytes with
 * practically no torque. */
static const uint8_t filling[16] = {3, 3, 3, 3, 3, 3, 3, 3, 3, 3, 3, 3, 3, 3, 3, 3};
static const uint8_t no_torque[FRAME] = {TORQUES, ID};

int hapi_open(const char *path) {
    const int port = open(path, O_RDWR | O_NOCTTY | O_NONBLOCK | O_CLOEXEC);
    struct termios settings;
    if (port < 0 || tcgetattr(port, &settings) != 0) {
        fprintf(stderr, "%s: %s. Expected Haply's serial port, such as /dev/ttyACM0\n", path, strerror(errno));
        return -1;
    }
    if (flock(port, LOCK_EX | LOCK_NB) != 0) {
        fprintf(stderr, "%s: another program holds this port. End it first\n", path);
        return -1;
    }
    cfmakeraw(&settings);
    settings.c_cflag |= CLOCAL | CREAD;
    settings.c_cc[VMIN] = 1; /* so that read() tells an empty port from one that hung up */
    cfsetspeed(&settings, B115200); /* USB ignores it; 1200 would start the boot loader */
    if (tcsetattr(port, TCSANOW, &settings) != 0 || ioctl(port, TIOCEXCL) != 0) {
        fprintf(stderr, "%s: %s\n", path, strerror(errno));
        return -1;
    }
    return port;
}

static bool send(int port, const void *bytes, size_t count) {
    return write(port, bytes, count) == (ssize_t)count;
}

bool hapi_set_up(int port, const hapi_wiring *wiring, const float degrees[2]) {
    uint8_t frame[10 + 16] = {SET_UP, ID, 3, 0, 0, 3, 0, 0, 0, 0}; /* ports 1 and 2; no sensors, no other PWM */
    for (int arm = 0; arm < 2; arm++) {
        const int at = wiring->port[arm] - 1;
        frame[3 + at] = wiring->motor_direction[arm];
        frame[6 + at] = wiring->encoder_direction[arm];
        memcpy(&frame[10 + 8 * at], &degrees[arm], 4);
        memcpy(&frame[14 + 8 * at], &wiring->counts, 4);
    }
    const uint8_t reset[] = {RESET, ID};
    return send(port, reset, sizeof reset) && send(port, frame, sizeof frame);
}

/* Reads until `count` bytes have come or none came for `ms`; reads up to `room` bytes. Returns how many came, or -1 if
 * the port is gone. */
static int receive(int port, uint8_t *bytes, int count, int room, int ms) {
    struct pollfd ready = {port, POLLIN, 0};
    int got = 0;
    while (got < count && poll(&ready, 1, ms) > 0) {
        const ssize_t more = read(port, bytes + got, (size_t)(room - got));
        if (more > 0) {
            got += (int)more;
        } else if (more == 0 || (errno != EAGAIN && errno != EINTR) || (ready.revents & (POLLHUP | POLLERR))) {
            return -1;
        }
    }
    return got;
}

hapi_result hapi_exchange(int port, const hapi_wiring *wiring, const double torque[2], double degrees[2]) {
    uint8_t frame[FRAME], answer[64];
    float angle[2];
    memcpy(frame, no_torque, FRAME);
    for (int arm = 0; arm < 2; arm++) {
        const float out = isfinite(torque[arm]) ? (float)torque[arm] : 0.0f;
        memcpy(&frame[2 + 4 * (wiring->port[arm] - 1)], &out, 4);
    }
    const int before = receive(port, answer, 1, sizeof answer, 0);
    if (before < 0 || !send(port, frame, FRAME)) {
        return HAPI_GONE;
    }
    const int got = receive(port, answer, ANSWER, sizeof answer, HAPI_ANSWER_MS);
    if (got <= 0) {
        return got < 0 ? HAPI_GONE : HAPI_SILENT;
    }
    if (before == 0 && got == 1 && answer[0] == ID) {
        return HAPI_NOT_SET_UP;
    }
    for (int arm = 0; arm < 2; arm++) {
        memcpy(&angle[arm], &answer[1 + 4 * (wiring->port[arm] - 1)], 4);
    }
    if (before > 0 || got != ANSWER || answer[0] != ID || !isfinite(angle[0]) || !isfinite(angle[1])) {
        return HAPI_GARBLED;
    }
    degrees[0] = angle[0];
    degrees[1] = angle[1];
    return HAPI_ANSWERED;
}

void hapi_find_back(int port) {
    uint8_t dropped[64];
    (void)send(port, filling, sizeof filling);
    for (int tries = 0; tries < 5 && receive(port, dropped, 1, sizeof dropped, SILENCE_MS) > 0; tries++) {
    }
}

void hapi_release(int port) {
    for (int tries = 0; tries < 2; tries++) { /* an unfinished frame may swallow part of the first try */
        (void)send(port, filling, sizeof filling);
        (void)send(port, no_torque, FRAME);
    }
}
