/* The harness with the knob for its board: what the harness calls of the state machine goes through loop(), the port and
 * the timer, as a sketch calls it. */
#include "knob.h"
#include "given_serial.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

static const int64_t OUTSIDE = 1ll << 40;
static GivenSensor sensor;
static BLDCMotor motor(7);
static float given = -1; /* rad, in place of what is measured */

unsigned long micros() {
    return now;
}

void hapsim_platform_feed_watchdog() {
    fed++;
}

/* As often as a motor's loop() comes round between two events. */
static void come_round() {
    sensor.give(found == 2 ? OUTSIDE : measured[0]);
    sensor.within = given == -1 ? sensor.within : given;
    motor.motor_status = found == 6 ? FOCMotorStatus::motor_error : FOCMotorStatus::motor_ready;
    hapsim_knob_loop();
    hapsim_knob_loop();
    put_out[0] = motor.enabled ? (int32_t)lroundf(motor.target) : 0;
}

void knob_init(void) {
    motor.linkSensor(&sensor);
    motor.initFOC();
    motor.voltage_limit = 2e9f;
    hapsim_knob_begin(motor, Serial, 1);
    come_round();
}

void knob_take_byte(uint8_t byte) {
    come_round();
    waiting = byte;
    come_round();
}

void knob_tick(void) {
    come_round();
    hapsim_knob_tick();
    come_round();
}

bool knob_look(void) {
    come_round();
    return true;
}

/*   angle RAD|-1         what the sensor says in place of a position; -1: the position
 *   begin TARGET         the sketch's constant: the target for 1 N m; tells whether that was accepted, as the force
 *   turned               the sensor counts against the motor
 *   stalled              a tick, and loop() does not come round
 *   driver               tells whether the driver is enabled, as the force
 */
void knob_obey(const char *line) {
    const char *rest = strchr(line, ' ');
    if (strncmp(line, "angle", 5) == 0) {
        given = strtof(rest, NULL);
    } else if (strncmp(line, "begin", 5) == 0) {
        put_out[0] = hapsim_knob_begin(motor, Serial, strtof(rest, NULL));
    } else if (strncmp(line, "turned", 6) == 0) {
        motor.sensor_direction = Direction::CCW;
    } else if (strncmp(line, "stalled", 7) == 0) {
        hapsim_knob_tick();
    } else if (strncmp(line, "driver", 6) == 0) {
        put_out[0] = motor.enabled;
    }
}
