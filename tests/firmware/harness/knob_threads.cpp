/* The knob's two contexts as two threads, at full speed: loop() with a motor, a sensor and a host's bytes, and the timer.
 * Ends with 1 where a torque or an angle is none that was asked for or sensed, or a tick is lost. The compiler's thread
 * sanitizer sees what is shared without a rule. */
#include "knob.h"

#include <stdio.h>
#include <string.h>
#include <thread>

extern "C" {
#include "device/hapsim_device.h"
}

static const int32_t TORQUES[] = {0x00070707, -0x00080808}, ANGLES[] = {0x01020304, 0x7a7b7c7d};
static const unsigned TICKS = 20000;
static GivenSensor sensor;
static BLDCMotor motor(7);
static bool wrong_angle, wrong_torque, over;
static unsigned fed, forces;

/* The host: arms, and answers each position as it comes. The side in the state machine writes to it, loop() reads. */
static uint8_t to_device[64];
static int to_read, end_read;
static uint32_t heard = UINT32_MAX;
HardwareSerial Serial;

static void ask(uint8_t type, uint32_t number, uint8_t argument, int32_t word, bool armed) {
    const hapsim_format format = armed ? hapsim_armed_format(1, 0) : hapsim_setup_format();
    size_t at = 1;
    to_device[at++] = (uint8_t)(type << 4 | number >> 8);
    to_device[at++] = (uint8_t)number;
    to_device[at++] = argument;
    memcpy(to_device + at, &word, 4);
    hapsim_stuff(to_device, at += 4);
    at += hapsim_put_check(&format, hapsim_check(&format, to_device, at), to_device + at);
    to_device[at++] = 0;
    to_read = 0;
    end_read = (int)at;
}

int HardwareSerial::available() {
    const uint32_t sample = __atomic_exchange_n(&heard, UINT32_MAX, __ATOMIC_SEQ_CST);
    if (to_read == end_read && sample != UINT32_MAX) {
        ask(HAPSIM_FORCE, sample, 50, TORQUES[forces++ % 2], true);
    }
    return end_read - to_read;
}

int HardwareSerial::read() {
    return to_device[to_read++];
}

int HardwareSerial::availableForWrite() {
    return 64;
}

size_t HardwareSerial::write(const uint8_t *bytes, size_t count) {
    uint8_t frame[16];
    memcpy(frame, bytes, 7);
    int32_t angle;
    const uint8_t type = hapsim_unstuff(frame, 7) ? frame[1] >> 4 : 0;
    memcpy(&angle, frame + 3, 4);
    if (type == HAPSIM_POSITION || type == HAPSIM_POSITION_HELD) {
        wrong_angle = wrong_angle || (angle != ANGLES[0] && angle != ANGLES[1]);
        __atomic_store_n(&heard, (uint32_t)((frame[1] & 15) << 8 | frame[2]), __ATOMIC_SEQ_CST);
    }
    return count;
}

unsigned long micros() {
    return 0;
}

void hapsim_platform_feed_watchdog() {
    __atomic_add_fetch(&fed, 1, __ATOMIC_SEQ_CST);
}

/* A tick for each round of loop() or more seldom: more would be a loop() that has stalled. */
static unsigned asked, rounds_so_far;
static void tick_on() {
    unsigned before = 0;
    while (!__atomic_load_n(&over, __ATOMIC_SEQ_CST)) {
        const unsigned now = __atomic_load_n(&rounds_so_far, __ATOMIC_SEQ_CST);
        if (now != before) {
            before = now;
            asked++;
            hapsim_knob_tick();
        }
        while (__atomic_load_n(&fed, __ATOMIC_SEQ_CST) != asked) { /* loop() may do it, but it is done */
        }
        std::this_thread::yield();
    }
}

int main() {
    motor.linkSensor(&sensor);
    motor.initFOC();
    sensor.give(0);
    motor.voltage_limit = 2e9f;
    hapsim_knob_begin(motor, Serial, 1);
    sensor.give(ANGLES[0]);
    hapsim_knob_loop();
    ask(HAPSIM_ARM, 2000, 0, (int32_t)HAPSIM_SCHEMA_HASH, false);
    std::thread timer(tick_on);
    unsigned pushed = 0, round = 0;
    for (; __atomic_load_n(&fed, __ATOMIC_SEQ_CST) < TICKS; round++) {
        sensor.give(ANGLES[round % 2]);
        hapsim_knob_loop();
        __atomic_store_n(&rounds_so_far, round + 1, __ATOMIC_SEQ_CST);
        pushed += motor.target != 0;
        wrong_torque = wrong_torque || (motor.target != 0 && motor.target != TORQUES[0] && motor.target != TORQUES[1]);
        std::this_thread::yield();
    }
    __atomic_store_n(&over, true, __ATOMIC_SEQ_CST);
    timer.join();
    printf("%u ticks, %u forces, %u of %u rounds pushed\n", fed, forces, pushed, round);
    return wrong_angle || wrong_torque || fed != asked || hapsim_device_state() != HAPSIM_ARMED;
}
