/* SPDX-License-Identifier: MIT */
/* A motor of SimpleFOC as a force-feedback device of hapsim, one channel in rad and N m.
 *
 *     setup():  sensor, driver and motor as usual, motor.init(), motor.initFOC();
 *               hapsim_knob_begin(motor, Serial, 150.0f);
 *     loop():   hapsim_knob_loop();      and nothing that waits
 *
 * There are two contexts. Only loop() uses motor, driver and sensor; it also runs the FOC and takes the host's bytes.
 * The tick runs beside loop(), perhaps on another core: in a timer task (ESP32) or in a timer's interrupt (STM32). They
 * share
 *   - the torque, an angle and a fault. Each is one word, written by one side and read by the other.
 *   - the state machine. The tick or a byte is in it, never both. If a tick finds it busy, the other side does that
 *     tick before it goes on. So the tick waits for nothing, and loop() waits only for a tick.
 */
#ifndef HAPSIM_KNOB_H
#define HAPSIM_KNOB_H

#include <Arduino.h>
#include <SimpleFOC.h>

/* Takes over the motor and starts the tick. `target_per_nm` is the motor.target for 1 N m: in volts, or in amperes if
 * current is sensed or motor.phase_resistance is set. Returns false if the motor is not calibrated, or if the torque
 * limit in these units is not a number or exceeds the motor's own limit. Then the motor stays disabled, and an armed
 * device latches with fault 6. */
bool hapsim_knob_begin(FOCMotor &motor, Stream &port, float target_per_nm);

/* Runs a round of the FOC and processes the received bytes. */
void hapsim_knob_loop();

/* Ends a sample period. The platform's timer calls it. */
void hapsim_knob_tick();

#endif
