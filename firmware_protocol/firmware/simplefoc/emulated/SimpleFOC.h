/* SPDX-License-Identifier: MIT */
/* The few calls of SimpleFOC 2.3 and 2.4 that a knob uses, with the same names, types and order. board.cpp simulates
 * the motor's motion and what an MT6701 senses. */
#ifndef SIMPLEFOC_H
#define SIMPLEFOC_H

#include <Arduino.h>

#define NOT_SET -12345.0f
#define _isset(value) ((value) != (NOT_SET))

enum Direction : int8_t { CW = 1, CCW = -1, UNKNOWN = 0 };
enum MotionControlType : uint8_t { torque, velocity, angle };
enum TorqueControlType : uint8_t { voltage, dc_current, foc_current };
enum FOCMotorStatus : uint8_t { motor_uninitialized = 0, motor_ready = 4, motor_error = 8, motor_calib_failed = 14 };

class Sensor {
public:
    virtual float getMechanicalAngle() {
        return angle_prev;
    }
    virtual int32_t getFullRotations() {
        return full_rotations;
    }
    virtual void update() {
        const float val = getSensorAngle();
        if (val < 0) {
            return;
        }
        const float d_angle = val - angle_prev;
        if (d_angle > 5.0265f || d_angle < -5.0265f) {
            full_rotations += d_angle > 0 ? -1 : 1;
        }
        angle_prev = val;
    }

protected:
    virtual float getSensorAngle() = 0;
    float angle_prev = 0;
    int32_t full_rotations = 0;
};

class MagneticSensorMT6701SSI : public Sensor {
public:
    explicit MagneticSensorMT6701SSI(int) {}
    void init() {
        angle_prev = getSensorAngle();
    }

protected:
    float getSensorAngle() override;
};

class BLDCDriver3PWM {
public:
    BLDCDriver3PWM(int, int, int, int, int, int) {}
    int init() {
        return 1;
    }
    float voltage_power_supply = 12;
};

class FOCMotor {
public:
    virtual int init() = 0;
    virtual int initFOC() = 0;
    virtual void enable() = 0;
    virtual void disable() = 0;
    virtual void loopFOC() = 0;
    virtual void move(float target = NOT_SET) = 0;
    void linkSensor(Sensor *linked) {
        sensor = linked;
    }

    Sensor *sensor = nullptr;
    float target = 0, voltage_limit = 12, current_limit = 2, voltage_sensor_align = 3;
    float phase_resistance = NOT_SET, zero_electric_angle = NOT_SET;
    int8_t enabled = 0;
    FOCMotorStatus motor_status = motor_uninitialized;
    TorqueControlType torque_controller = TorqueControlType::voltage;
    MotionControlType controller = MotionControlType::torque;
    Direction sensor_direction = Direction::UNKNOWN;
    unsigned int motion_downsample = 0;
};

class BLDCMotor : public FOCMotor {
public:
    explicit BLDCMotor(int) {}
    void linkDriver(BLDCDriver3PWM *) {}
    int init() override;
    int initFOC() override;
    void enable() override;
    void disable() override;
    void loopFOC() override;
    void move(float new_target) override;
};

#endif
