/* SPDX-License-Identifier: MIT */
/* The port layer: the board's functions that the state machine (hapsim_device.c) calls. You write these functions, and
 * the constants in your board's own hapsim_board.h. Nothing else has to change.
 *
 * Two contexts call them. The *tick* is the sample timer's interrupt, which calls hapsim_device_tick. The *main loop*
 * (or a task) gives the received bytes to hapsim_device_take_byte. Only the tick may interrupt the main loop's calls.
 * A board that follows lines has a third, the *step*, which may interrupt both: it calls hapsim_device_step, which
 * measures and puts out forces.
 */
#ifndef HAPSIM_PORT_H
#define HAPSIM_PORT_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

/* Returns a free-running clock with HAPSIM_BOARD_PERIOD_TICKS per sample period. It wraps at 32 bits. */
uint32_t hapsim_port_now(void);

/* Measures the positions of all channels now, in counts. If `parts` has HAPSIM_WITH_VELOCITY, all velocities follow;
 * if it has HAPSIM_WITH_ACCELERATION, all accelerations then; if it has HAPSIM_WITH_FORCE, the forces of the hand on all
 * handles then. It has only parts for which hapsim_board.h has scales: a board without sensors ignores it. The forces of hapsim_port_put_forces act already, and an acceleration should show
 * them (age 0). Returns HAPSIM_NO_FAULT, HAPSIM_POSITION_OUT_OF_RANGE if a position does not fit 32 bits, or
 * HAPSIM_HARDWARE. Other values that do not fit saturate. The device's zero is where it powered up or homed: this
 * function must not move it. */
uint8_t hapsim_port_measure(int32_t *counts, uint8_t parts);

/* Puts out the forces of all channels, in counts, until the next call. They are already within the limits. A positive
 * force accelerates towards larger positions. After a reset the outputs must be at zero before the first call. */
void hapsim_port_put_forces(const int32_t *counts);

/* A board with HAPSIM_BOARD_SPEED_LIMIT, whose servo follows position commands, writes this too: the commands of all
 * channels, in counts of position, until the next call. The first call begins the torque, where the handle is; the next
 * call of hapsim_port_put_forces ends it, at once. Commands never leap by more than the speed limit, and end at the
 * braking deceleration. */
void hapsim_port_put_commands(const int32_t *counts);

/* A board with HAPSIM_BOARD_DIGITAL_WORD writes two more. The first returns the levels of its inputs now, the second sets
 * its outputs until the next call; a bit without a pin reads 0 and is ignored. Both come at the tick, right after the
 * positions are measured and the forces put out; neither may wait. The outputs are 0 after a reset, and whenever the
 * device releases. */
uint32_t hapsim_port_read_inputs(void);
void hapsim_port_put_outputs(uint32_t outputs);

/* Gives a whole frame to the transmitter. MUST NOT WAIT: without room it sends no byte and returns false. The next
 * sample carries newer data anyway. While a tick waits for a host that does not read, nothing supervises the force. */
bool hapsim_port_write(const uint8_t *bytes, size_t count);

/* Feeds the hardware watchdog. Only the tick calls it, so that a dead tick ends in a reset, and a reset in zero force.
 * Set the watchdog to some 10 to 60 sample periods. */
void hapsim_port_feed_watchdog(void);

/* Restarts the sample timer when the host arms the device: the next tick comes one whole sample period from now. */
void hapsim_port_begin(void);

/* Disable the tick's interrupt, and the step's, and enable them again. The receiver's interrupt stays enabled: bytes come at any time.
 * Both must be functions in another file, or contain a memory barrier, so that the compiler moves nothing across
 * them. */
void hapsim_port_hold_tick(void);
void hapsim_port_let_tick(void);

#endif
