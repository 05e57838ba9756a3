/* SPDX-License-Identifier: MIT */
#define _GNU_SOURCE
#include "terminal.h"

#include <fcntl.h>
#include <stdlib.h>
#include <termios.h>
#include <unistd.h>

static int make_raw(int end) {
    struct termios settings;
    if (tcgetattr(end, &settings) != 0) {
        return -1;
    }
    cfmakeraw(&settings);
    settings.c_oflag = 0;
    return tcsetattr(end, TCSANOW, &settings);
}

int open_terminal(char *path, int room) {
    const int near = posix_openpt(O_RDWR | O_NOCTTY);
    if (near < 0 || grantpt(near) != 0 || unlockpt(near) != 0 || ptsname_r(near, path, (size_t)room) != 0) {
        return -1;
    }
    const int far = open(path, O_RDWR | O_NOCTTY);
    if (far < 0 || make_raw(near) != 0 || make_raw(far) != 0 || fcntl(near, F_SETFL, O_NONBLOCK) != 0) {
        return -1;
    }
    return near;
}
