/* SPDX-License-Identifier: MIT */
/* The firmware on a Cortex-M3. SysTick makes the tick, and UART 0 is the port; the interrupt of its receiver has
 * priority over the tick and the step. In place of an encoder and a motor there is simulated_mass.c.
 *
 * The emulator logs a line for each force put out, even for the same force again. The line has two hexadecimal words:
 * microseconds and counts. The microseconds count ticks, because the emulator's clock runs on when its machine is held
 * up and ticks are lost.
 */
#include "hapsim_board.h"
#include "hapsim_device.h"
#include "hapsim_port.h"
#include "hardware.h"
#include "mps2.h"
#include "simulated_mass.h"

#define TICK_US (1000u / SIMULATED_STEPS)

void on_systick(void);
void on_pendsv(void);

static simulated_mass mass;
static int32_t force;
static uint32_t ticks;

#ifdef HAPSIM_BOARD_STEPS
/* SysTick makes the local periods. Its priority is above the tick's, which is a call for later. */
void on_systick(void) {
    ticks++;
    simulated_mass_move(&mass, force);
    if (hapsim_device_step()) {
        call_for_tick();
    }
}

void on_pendsv(void) {
    hapsim_device_tick();
}
#else
void on_systick(void) {
    ticks++;
    simulated_mass_move(&mass, force);
    hapsim_device_tick();
}
#endif

void hapsim_port_hold_tick(void) {
    keep_out(TIMER_PRIORITY);
}

void hapsim_port_let_tick(void) {
    keep_out(0);
}

uint32_t hapsim_port_now(void) {
    return ~TIMER0->value;
}

void hapsim_port_begin(void) {
    begin_period();
    simulated_mass_flick(&mass);
}

uint8_t hapsim_port_measure(int32_t *counts, uint8_t parts) {
    const bool fits = simulated_mass_position(&mass, &counts[0]);
    if (parts & HAPSIM_WITH_VELOCITY) {
        counts[1] = simulated_mass_velocity(&mass);
    }
    return fits ? HAPSIM_NO_FAULT : HAPSIM_POSITION_OUT_OF_RANGE;
}

void hapsim_port_put_forces(const int32_t *counts) {
    force = counts[0];
    note_force(ticks * TICK_US, force);
}

uint32_t hapsim_port_read_inputs(void) {
    return (BUTTONS & 3u) << 8 | (LEDS & 3u);
}

void hapsim_port_put_outputs(uint32_t outputs) {
    LEDS = outputs & 3u;
}

bool hapsim_port_write(const uint8_t *bytes, size_t count) {
    if (count > room_to_send()) {
        return false;
    }
    send_bytes(bytes, count);
    return true;
}

void hapsim_port_feed_watchdog(void) {
    feed_watchdog();
}

static bool take_byte(void) {
    const int byte = next_byte();
    if (byte == BYTES_WERE_LOST) {
        hapsim_device_lost_bytes();
    } else if (byte >= 0) {
        hapsim_device_take_byte((uint8_t)byte);
    }
    return byte != NOTHING_CAME;
}

int main(void) {
    start_hardware();
    note_force(0, 0); /* the force after the reset */
    hapsim_device_init();
    for (;;) {
        while (take_byte()) {
        }
        wake_often(hapsim_device_look());
        rest();
#ifdef HAPSIM_BROKEN_TICK /* the tick dies half a second after arming: the hardware watchdog must reset the chip */
        if (hapsim_device_register(HAPSIM_REG_ACCEPTED) > 500) {
            SYSTICK->control = 0;
        }
#endif
    }
}
