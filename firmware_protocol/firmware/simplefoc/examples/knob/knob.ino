/* SPDX-License-Identifier: MIT */
/* A knob with a gimbal motor and an MT6701, as a SmartKnob View has them. README.md says how to find the numbers. */
#include <SimpleFOC.h>
#include <SimpleFOCDrivers.h>
#include <encoders/mt6701/MagneticSensorMT6701SSI.h>
#include <hapsim_knob.h>

const float VOLTS_PER_NM = 330; /* phase resistance / torque constant: 10 ohm / 0.03 N m/A, an assumption */

BLDCMotor motor(7); /* pole pairs */
BLDCDriver6PWM driver(26, 25, 27, 32, 12, 33);
MagneticSensorMT6701SSI sensor(14);

void setup() {
    Serial.begin(921600);
#ifdef ARDUINO_ARCH_ESP32
    SPI.begin(13, 37, -1, 14); /* clock, data in, none out, select */
#endif
    sensor.init();
    driver.voltage_power_supply = 5;
    driver.init();
    motor.linkSensor(&sensor);
    motor.linkDriver(&driver);
    motor.voltage_limit = 4;
    motor.voltage_sensor_align = 3;
    /* Uncomment these with what a first start found, and no later start moves the knob.
    motor.zero_electric_angle = 2.77f;
    motor.sensor_direction = Direction::CW; */
    motor.init();
    motor.initFOC();
    hapsim_knob_begin(motor, Serial, VOLTS_PER_NM);
}

void loop() {
    hapsim_knob_loop();
}
