/* SPDX-License-Identifier: MIT */
/* A bridge: `haply PORT [v3|v2|devkit]` speaks hapsim's protocol on a pseudo-terminal, whose path it prints, and hAPI
 * on Haply's serial port. Forces in N at the end point become torques; angles become x and y in m.
 *
 * Haply's firmware keeps the last torque for ever. So every end of this process sends zero torque. If it was killed or
 * stopped, or its tick died, a guard process sends zero torque instead. Neither can reach a board whose USB plug was
 * pulled: that board keeps its torque until its power goes. */
#define _GNU_SOURCE
#include "hapi.h"
#include "hapsim_board.h"
#include "hapsim_device.h"
#include "hapsim_port.h"
#include "pantograph.h"
#include "process.h"

#include <errno.h>
#include <fcntl.h>
#include <math.h>
#include <poll.h>
#include <sched.h>
#include <stdio.h>
#include <string.h>
#include <sys/types.h>
#include <unistd.h>

#define FORCE_SCALE 1e-8
#define POSITION_SCALE 1e-7
#define MS 1000000ll
#ifndef GUARD_MS
#define GUARD_MS 500         /* longest time without a tick; other programs may hold this process up for long */
#endif
#define GUARD_GONE 2         /* a value of process_stopped: the reason */
#define TICKS_A_BEAT 32
#define JUMP_DEGREES 5.0     /* and DEGREES_PER_MS more: no hand turns a motor at 5000 degrees/s */
#define DEGREES_PER_MS 5.0
#define IDLE_TICKS 10        /* from one exchange to the next while unarmed */
#define TRIES_AT_START 20
#define TRIES 3
#define LAST_WORDS_MS 1000   /* time for the host to read STATUS before the port closes */

static const struct model {
    const char *name;
    pantograph arms;
    hapi_wiring wiring;
} models[] = {
    /* HaplyHAPI 1.0.1, README and Pantograph: plastic 2diy (3) and metal 2diy (2). */
    {"v3", {0.07, 0.09, 0.038}, {{2, 1}, {1, 1}, {1, 1}, {168, 12}, 4880}},
    {"v2", {0.07, 0.09, 0.0}, {{2, 1}, {1, 0}, {1, 0}, {241, -61}, 10752}},
    /* Haply-API-cpp, Pantograph.cpp; add_encoder of sketches for the development kit. */
    {"devkit", {0.05, 0.07, 0.02}, {{1, 2}, {0, 0}, {0, 0}, {180, 0}, 13824}},
};

static const struct model *model = models;
static const char *path;
static int board = -1, beat = -1;
static double degrees[2];
static pantograph_pose pose;
static int64_t answered, ends; /* times: of the last answer; of this process's end because of a fault (0: none) */
static bool fault, complained; /* since the last position; since the last good answer */
static long scaled;

static void begin_end(void) {
    fault = true;
    ends = ends ? ends : process_now() + LAST_WORDS_MS * MS;
}

static void complain(const char *what) {
    if (!complained && !ends) {
        fprintf(stderr, "%s: %s\n", path, what);
    }
    complained = true;
}

/* Makes one exchange. Returns NULL if its answer is plausible for a hand's motion, else the reason in words. */
static const char *attempt(const double torque[2]) {
    double read[2], angle[2];
    switch (hapi_exchange(board, &model->wiring, torque, read)) {
    case HAPI_ANSWERED: break;
    case HAPI_SILENT: return "no answer in time";
    case HAPI_GARBLED: return "an answer that is none, or two: bytes were lost or doubled";
    case HAPI_NOT_SET_UP:
        complain("the board lost its set-up. It was set up again for zero torque; hold the arms at their stops and "
                 "start the bridge again");
        (void)hapi_set_up(board, &model->wiring, (const float[]){(float)degrees[0], (float)degrees[1]});
        begin_end();
        return "the board lost its set-up";
    default:
        complain("the port hung up. The board keeps its last torque until its power goes: pull its power plug, then "
                 "start the bridge again");
        begin_end();
        return "the port hung up";
    }
    const int64_t now = process_now();
    const double allowed = JUMP_DEGREES + DEGREES_PER_MS * (double)(now - answered) / MS;
    for (int arm = 0; arm < 2; arm++) {
        if (answered && fabs(read[arm] - degrees[arm]) > allowed) {
            fprintf(stderr, "%s: the angle of arm %d jumped from %.1f to %.1f degrees. Look at its encoder, hold the "
                    "arms at their stops and start the bridge again\n", path, arm, degrees[arm], read[arm]);
            begin_end();
            return "an angle jumped";
        }
        angle[arm] = read[arm] * acos(-1) / 180;
    }
    if (!pantograph_forward(&model->arms, angle, &pose)) {
        complain("the arms cannot be as their angles say, or lie in one line. Move them to the middle; if they are "
                 "there, hold them at their stops and start the bridge again");
        fault = true;
    } else {
        complained = false;
    }
    memcpy(degrees, read, sizeof degrees);
    answered = now;
    return NULL;
}

/* Puts out the requested torque. If the exchange fails, tries to put out zero torque. */
static void exchange(const double torque[2]) {
    static const double none[2];
    const int most = complained ? 1 : TRIES; /* a silent board must not delay the tick so long that the guard acts */
    const char *why = attempt(torque);
    if (why != NULL) {
        fault = true;
        complain(why);
    }
    for (int tries = 0; why != NULL && tries < most; tries++) {
        hapi_find_back(board);
        why = attempt(none);
    }
}

uint8_t hapsim_port_measure(int32_t *counts, uint8_t parts) {
    (void)parts;
    const bool failed = fault;
    fault = ends != 0;
    for (int axis = 0; axis < 2 && !failed; axis++) {
        counts[axis] = (int32_t)lrint(pose.point[axis] / POSITION_SCALE);
    }
    return failed ? HAPSIM_HARDWARE : HAPSIM_NO_FAULT;
}

void hapsim_port_put_forces(const int32_t *counts) {
    const double force[2] = {counts[0] * FORCE_SCALE, counts[1] * FORCE_SCALE};
    double torque[2] = {0, 0};
    if ((counts[0] != 0 || counts[1] != 0) && !fault) {
        scaled += pantograph_torques(&pose, force, HAPI_TORQUE_LIMIT, torque);
    }
    exchange(torque);
}

void hapsim_port_feed_watchdog(void) {
    static unsigned ticks;
    if (++ticks % TICKS_A_BEAT == 0 && write(beat, "", 1) < 0 && errno != EAGAIN) {
        process_stopped = GUARD_GONE;
    }
}

void hapsim_port_begin(void) {
    process_restart_period();
}

/* Follows the arms while unarmed too, so that a lost board is noticed. */
static void before_tick(void) {
    static unsigned ticks;
    if (hapsim_device_state() != HAPSIM_ARMED && ++ticks % IDLE_TICKS == 0) {
        fault = ends != 0;
        exchange((const double[]){0, 0});
        if (scaled > 0) {
            fprintf(stderr, "%s: %ld forces needed more than the motors' %g N m and were made smaller\n", path, scaled,
                    HAPI_TORQUE_LIMIT);
            scaled = 0;
        }
    }
    if (ends && process_now() > ends) {
        process_stopped = 1;
    }
}

/* The guard: ends when the bridge ends, and sends zero torque first. */
static void watch(int beats, pid_t bridge) {
    struct pollfd next = {beats, POLLIN, 0};
    char some[64];
    for (;;) {
        const int came = poll(&next, 1, GUARD_MS);
        if ((came > 0 && read(beats, some, sizeof some) > 0) || (came < 0 && errno == EINTR)) {
            continue;
        }
        hapi_release(board);
        if (came == 0) {
            fprintf(stderr, "%s: the bridge did not tick for %d ms: zero torque, and its end\n", path, GUARD_MS);
            kill(bridge, SIGKILL);
            hapi_release(board);
        }
        _exit(0);
    }
}

static void guard_died(int number) {
    (void)number;
    process_stopped = GUARD_GONE;
}

/* Starts the guard in a session of its own, so that a closed terminal or Ctrl-C ends the bridge but not the guard. */
static bool start_guard(void) {
    int ends_of_pipe[2];
    const pid_t bridge = getpid();
    if (pipe2(ends_of_pipe, O_CLOEXEC) != 0) {
        return false;
    }
    /* Raises the priority of bridge and guard, where granted: even a killed process needs processor time to end. */
    (void)sched_setscheduler(0, SCHED_FIFO, &(struct sched_param){.sched_priority = 1});
    signal(SIGCHLD, guard_died);
    signal(SIGPIPE, SIG_IGN); /* a beat that no guard takes must not end the bridge before it sends zero torque */
    const pid_t child = fork();
    if (child == 0) {
        (void)setsid();
        close(ends_of_pipe[1]);
        watch(ends_of_pipe[0], bridge);
    }
    close(ends_of_pipe[0]);
    beat = ends_of_pipe[1];
    return child > 0 && fcntl(beat, F_SETFL, O_NONBLOCK) == 0;
}

static int begin(int count, char **words) {
    const size_t known = sizeof models / sizeof *models;
    while (count == 3 && model < models + known && strcmp(words[2], model->name) != 0) {
        model++;
    }
    if (count < 2 || count > 3 || model == models + known) {
        fprintf(stderr, "usage: haply PORT [v3|v2|devkit], such as haply /dev/ttyACM0 v3\n");
        return 2;
    }
    path = words[1];
    board = hapi_open(path);
    if (board < 0) {
        return 3;
    }
    if (!start_guard()) {
        fprintf(stderr, "no guard process is to be had: %s\n", strerror(errno));
        return 3;
    }
    const char *why = "";
    for (int tries = 0; why != NULL && tries < TRIES_AT_START; tries++) {
        hapi_find_back(board);
        (void)hapi_set_up(board, &model->wiring, model->wiring.at_start);
        why = attempt((const double[]){0, 0});
    }
    if (why != NULL || fault) {
        fprintf(stderr, "%s: %s. Expected a Haply board with hAPI's firmware, powered\n", path,
                why != NULL ? why : "impossible angles");
        return 3;
    }
    fprintf(stderr, "%s: a %s, its end point at x %.1f mm, y %.1f mm: right if the arms are at their stops now\n", path,
            model->name, pose.point[0] * 1e3, pose.point[1] * 1e3);
    hapsim_device_init();
    return process_open();
}

int main(int count, char **words) {
    int status = begin(count, words);
    if (status == 0) {
        process_serve(before_tick);
        if (process_stopped == GUARD_GONE) {
            fprintf(stderr, "%s: the guard of this bridge ended, so it ends too, with zero torque\n", path);
        }
        status = ends || process_stopped == GUARD_GONE ? 3 : 0;
    }
    if (board >= 0) {
        signal(SIGCHLD, SIG_DFL);
        hapi_release(board);
    }
    return status;
}
