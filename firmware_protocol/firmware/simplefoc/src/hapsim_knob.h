/* SPDX-License-Identifier: MIT */
/* A motor of SimpleFOC as a force-feedback device of hapsim, one channel in rad and N m.
 *
 *     setup():  sensor, driver and motor as usual, motor.init(), motor.initFOC();
 *               hapsim_knob_begin(motor, Serial, 150.0f);
 *     loop():   hapsim_knob_loop();      and nothing that waits
 *
 * Two contexts. loop() alone touches motor, driver and sensor: it runs the FOC and takes the host's bytes. The tick, in
 * a timer task (ESP32) or a timer's interrupt (STM32), runs beside it, perhaps on another core. They share
 *   - the torque, an angle and a fault: a word each, written whole by one side and read whole by the other;
 *   - the state machine: the tick or a byte is in it, never both. Where a tick finds it taken, the side that has it does
 *     that tick before it goes on. So the tick waits for nothing, and loop() only for a tick.
 */
#ifndef HAPSIM_KNOB_H
#define HAPSIM_KNOB_H

#include <Arduino.h>
#include <SimpleFOC.h>

/* Takes the motor over and starts the tick. `target_per_nm`: the motor.target of 1 N m: volts, or amperes where current
 * is sensed or motor.phase_resistance is set. False where the motor is not calibrated, or where the torque limit in these
 * units is no number or beyond the motor's own limit; then the motor stays disabled, and an armed device latches with
 * fault 6. */
bool hapsim_knob_begin(FOCMotor &motor, Stream &port, float target_per_nm);

/* Runs a round of the FOC and processes the received bytes. */
void hapsim_knob_loop();

/* Ends a sample period. The platform's timer calls it. */
void hapsim_knob_tick();

#endif
