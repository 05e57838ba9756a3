/* SPDX-License-Identifier: MIT */
/* A knob with a gimbal motor and an MT6701: the pins of a NanoD++. README.md has the pins of other knobs, and describes
 * how to find the numbers. */
#include <SimpleFOC.h>
#include <SimpleFOCDrivers.h>
#include <encoders/mt6701/MagneticSensorMT6701SSI.h>
#include <hapsim_knob.h>

const float VOLTS_PER_NM = 176; /* phase resistance / torque constant: 2.645 ohm / 0.015 N m/A (a guess) */

BLDCMotor motor(7); /* pole pairs */
BLDCDriver3PWM driver(34, 35, 37, 33, 48, 36);
MagneticSensorMT6701SSI sensor(17);

void setup() {
    Serial.begin(921600);
#ifdef ARDUINO_ARCH_ESP32
    SPI.begin(18, 21, -1, 17); /* clock, data in, none out, select */
#endif
    sensor.init();
    driver.voltage_power_supply = 5;
    driver.init();
    motor.linkSensor(&sensor);
    motor.linkDriver(&driver);
    motor.voltage_limit = 2; /* 0.76 A at standstill */
    motor.voltage_sensor_align = 1;
    /* Enter the numbers of the first start and uncomment these lines; then no later start moves the knob.
    motor.zero_electric_angle = 2.77f;
    motor.sensor_direction = Direction::CW; */
    motor.init();
    motor.initFOC();
    hapsim_knob_begin(motor, Serial, VOLTS_PER_NM);
}

void loop() {
    hapsim_knob_loop();
}
