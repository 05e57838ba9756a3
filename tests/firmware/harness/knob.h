/* A motor and a port without hardware, for what tests the knob: the sensor senses what it is given. */
#ifndef KNOB_H
#define KNOB_H

#include <SimpleFOC.h>

#include "hapsim_knob.h"
#include "hapsim_platform.h"

#define TURN 16384

struct GivenSensor : Sensor {
    float within = 0;
    int32_t turns = 0;
    void give(int64_t counts) {
        turns = (int32_t)(counts >> 14);
        within = (float)(counts & (TURN - 1)) * (6.283185307f / TURN);
    }
    void update() override {
        angle_prev = within;
        full_rotations = turns;
    }

protected:
    float getSensorAngle() override {
        return within;
    }
};

int BLDCMotor::init() {
    return 1;
}
int BLDCMotor::initFOC() {
    motor_status = FOCMotorStatus::motor_ready;
    return 1;
}
void BLDCMotor::enable() {
    enabled = 1;
}
void BLDCMotor::disable() {
    enabled = 0;
}
void BLDCMotor::move(float new_target) {
    if (enabled) {
        target = new_target;
    }
}
void BLDCMotor::loopFOC() {
    sensor->update();
}

void hapsim_platform_begin(uint32_t) {}
void hapsim_platform_restart(uint32_t) {}

#endif
