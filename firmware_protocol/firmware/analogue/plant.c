/* SPDX-License-Identifier: MIT */
/* A motor on its bridge moves a mass, and a voltage reports its position. All values are at the handle, in SI:
 *
 *     m dv/dt = F(duty) - (friction + emf) v - coulomb sign(v)       F = full duty^2 where the firmware takes a root
 *
 * `emf` is the friction of the back-EMF, k^2/R of the motor; it acts while the bridge drives. The force is that of the
 * bridge's duty, which is known at the end of each pulse. The model omits ripple, inductance and switching losses. */
#include "plant.h"

#include "hapsim_board.h"

#include <avr_adc.h>
#include <avr_ioport.h>
#include <math.h>
#include <sim_interrupts.h>
#include <sim_io.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#define HZ 16e6
#define STEP 160u       /* cycles, 10 us: the longest step of the motion */
#define PWM_PERIOD 256u
#define LATE 6          /* cycles: simavr moves a pin between two instructions */
#define COMPARE_B 12u   /* vector of timer 1 */

typedef struct {
    char pwm_port, pwm, direction_port, direction;
    uint8_t compare; /* compare register of the pin's timer */
} pins;
#define COMPARE_0A 0x47
#define COMPARE_0B 0x48
#define COMPARE_2A 0xb3
#define COMPARE_2B 0xb4
#define MOTOR(timer, output, port, bit, to_port, to_bit) {#port[0], bit, #to_port[0], to_bit, COMPARE_##timer##output}
static const pins motors[HAPSIM_BOARD_CHANNELS] = MOTORS;
static const uint8_t sensors[HAPSIM_BOARD_CHANNELS] = SENSORS;

typedef struct {
    double x, v;
    bool high, forward; /* the pins */
    uint64_t edge;      /* cycle of the last PWM edge */
    int32_t duty;
    double told; /* the sensor's voltage, in counts of the converter */
} channel;

static channel channels[HAPSIM_BOARD_CHANNELS];
static avr_t *chip;
static avr_irq_t *converter;
static void (*note_drive)(uint64_t, int32_t);
static uint64_t now, driven; /* cycles: the motion is computed up to `now`; channel 0 was first driven at `driven` */
static uint64_t seed;

/* The properties that can be set, by name. */
static double mass = PLANT_MASS, friction = PLANT_FRICTION, coulomb = PLANT_COULOMB, emf = PLANT_EMF, full = PLANT_FULL;
static double noise = PLANT_NOISE, random_seed = 1, wire_off = INFINITY, leap = INFINITY, disconnected = 0;
static double touch = INFINITY, lift = INFINITY;
static const struct {
    const char *name, *what;
    double *value;
} properties[] = {
    {"mass", "kg", &mass},
    {"friction", "N s/m, without the motor's", &friction},
    {"emf", "N s/m, the back-EMF's", &emf},
    {"coulomb", "N of dry friction", &coulomb},
    {"full", "N at full duty", &full},
    {"noise", "counts rms on the sensor", &noise},
    {"seed", "of the noise", &random_seed},
    {"wire_off", "s after the first force: the sensor's wire comes off", &wire_off},
    {"leap", "s after the first force: the sensor leaps by a third of its range", &leap},
    {"disconnected", "1: the motor is", &disconnected},
    {"touch", "s after the first force: a finger touches the first pad", &touch},
    {"lift", "s after the first force: it is lifted", &lift},
};
enum { PROPERTIES = sizeof properties / sizeof *properties };

bool set_plant(const char *word) {
    const char *is = strchr(word, '=');
    char *end = NULL;
    for (int i = 0; is && i < PROPERTIES; i++) {
        if (strlen(properties[i].name) == (size_t)(is - word) && !strncmp(word, properties[i].name, (size_t)(is - word))) {
            *properties[i].value = strtod(is + 1, &end);
            return end != is + 1 && !*end;
        }
    }
    return false;
}

void tell_plant(void) {
    for (int i = 0; i < PROPERTIES; i++) {
        fprintf(stderr, "%s=%g (%s)\n", properties[i].name, *properties[i].value, properties[i].what);
    }
}

/* Returns a roughly normal number: the sum of four numbers of Marsaglia's xorshift. */
static double random_normal(void) {
    double sum = 0;
    for (int i = 0; i < 4; i++) {
        seed ^= seed << 13, seed ^= seed >> 7, seed ^= seed << 17;
        sum += (double)(seed >> 11) / 9007199254740992.0 - 0.5;
    }
    return sum * sqrt(3.0);
}

static void move(channel *one, double seconds) {
    const double share = abs(one->duty) / 256.0;
    const double size = (DUTY_IS_ROOT ? share * share : share) * full * (disconnected == 0);
    const double drive = one->duty < 0 ? -size : size;
    const double push = drive - (friction + (one->duty ? emf : 0)) * one->v;
    const double before = one->v;
    if (before == 0 && fabs(push) <= coulomb) {
        return;
    }
    const double against = before != 0 ? copysign(coulomb, before) : copysign(coulomb, push);
    one->v += (push - against) / mass * seconds;
    if (before * one->v < 0) {
        one->v = 0; /* dry friction stops the mass and does not turn it back */
    }
    one->x += 0.5 * (before + one->v) * seconds;
}

static void set_duty(channel *one, uint64_t from, int32_t duty) {
    if (duty == one->duty) {
        return;
    }
    one->duty = duty;
    if (one == channels) {
        driven = driven ? driven : from;
        note_drive(from, duty);
    }
}

static bool active(const channel *one) {
    return one->high != (TWO_INPUTS && one->forward == FORWARD_HIGH);
}

static int32_t signed_duty(const channel *one, int32_t size) {
    return one->forward ? size : -size;
}

/* Returns the length of the pulse that ends now. Within simavr's resolution this is the length that the timer sets. */
static int32_t length_of(const channel *one) {
    const int32_t seen = (int32_t)(chip->cycle - one->edge), set = chip->data[motors[one - channels].compare] + 1;
    return abs(seen - set) <= LATE ? set : seen;
}

/* Moves all channels up to now. A pin without an edge for a whole period is either off or always on. */
static void move_on(void) {
    const uint64_t until = chip->cycle;
    while (now < until) {
        const uint64_t to = until - now < STEP ? until : now + STEP;
        for (int c = 0; c < HAPSIM_BOARD_CHANNELS; c++) {
            channel *one = &channels[c];
            if (now >= one->edge + PWM_PERIOD + 2) {
                set_duty(one, one->edge, active(one) ? signed_duty(one, 256) : 0);
            }
            move(one, (double)(to - now) / HZ);
        }
        now = to;
    }
}

static void on_pwm(avr_irq_t *irq, uint32_t high, void *which) {
    channel *one = which;
    (void)irq;
    if (one->high == (high != 0)) {
        return;
    }
    move_on();
    const bool ends = active(one);
    const int32_t length = length_of(one);
    one->high = high != 0;
    one->edge = chip->cycle;
    if (ends && length <= (int32_t)PWM_PERIOD) {
        set_duty(one, chip->cycle, signed_duty(one, length));
    }
}

static void on_direction(avr_irq_t *irq, uint32_t high, void *which) {
    (void)irq;
    move_on();
    ((channel *)which)->forward = (high != 0) == FORWARD_HIGH;
}

static double since_driven(void) {
    return driven ? (double)(chip->cycle - driven) / HZ : 0;
}

/* Returns the sensor's reading in counts, before the converter rounds it and limits it to 0 to 1023. */
static double reading(const channel *one) {
    const double off = since_driven() >= leap ? 340 : 0;
#ifdef TOOTH
    const double at = one->x / COUNT_M + off + 0.31 * TOOTH;
    const double told = SENSOR_LEAST + at - TOOTH * floor(at / TOOTH);
#else
    const double told = 511.5 + one->x / COUNT_M + off;
#endif
    return since_driven() >= wire_off ? 1023 : told + noise * random_normal();
}

/* A conversion begins: samples the pin now, because simavr would read it only when the firmware does. */
static void on_conversion(avr_irq_t *irq, uint32_t mux, void *unused) {
    (void)irq, (void)unused;
    union {
        avr_adc_mux_t mux;
        uint32_t value;
    } chosen = {.value = mux};
    move_on();
    for (int c = 0; c < HAPSIM_BOARD_CHANNELS; c++) {
        if (sensors[c] == chosen.mux.src) {
            const double told = floor(reading(&channels[c]) + 0.5);
            avr_raise_irq(converter + ADC_IRQ_ADC0 + sensors[c], (uint32_t)(told < 0 ? 0 : told > 1023 ? 1023 : told));
        }
    }
}

/* Starts the converter at compare match B, as the chip does; simavr supports only free running. */
static void on_match(avr_irq_t *irq, uint32_t pending, void *unused) {
    (void)irq, (void)unused;
    if (pending) {
        avr_raise_irq(converter + ADC_IRQ_IN_TRIGGER, 1);
    }
}

static avr_irq_t *pin(char port, char bit) {
    return avr_io_getirq(chip, AVR_IOCTL_IOPORT_GETIRQ(port), IOPORT_IRQ_PIN0 + bit);
}

#ifdef TOUCHES
#define TOUCH(port, bit) {#port[0], bit}
static const struct {
    char port, bit;
} pads[] = TOUCHES;
enum { PADS = sizeof pads / sizeof *pads };

static avr_cycle_count_t on_charged(avr_t *avr, avr_cycle_count_t when, void *irq) {
    (void)avr, (void)when;
    avr_raise_irq(irq, 1);
    return 0;
}

/* A pad that is an input charges through 1 Mohm up to 0.6 of the supply, where the pin reads high; else it is low. */
static void on_directions(avr_irq_t *irq, uint32_t outputs, void *port) {
    (void)irq;
    for (int i = 0; i < PADS; i++) {
        avr_irq_t *own = pin(pads[i].port, pads[i].bit);
        const bool finger = i == 0 && since_driven() >= touch && since_driven() < lift;
        const double farad = PLANT_PAD + (finger ? PLANT_FINGER : 0);
        if (pads[i].port != *(const char *)port) {
            continue;
        }
        avr_cycle_timer_cancel(chip, on_charged, own);
        if (outputs >> pads[i].bit & 1) {
            avr_raise_irq(own, 0);
        } else {
            avr_cycle_timer_register(chip, (avr_cycle_count_t)(-log(1 - 0.6) * 1e6 * farad * HZ), on_charged, own);
        }
    }
}

static void connect_pads(void) {
    for (int i = 0; i < PADS; i++) {
        if (i == 0 || pads[i].port != pads[i - 1].port) {
            avr_irq_t *directions = avr_io_getirq(chip, AVR_IOCTL_IOPORT_GETIRQ(pads[i].port), IOPORT_IRQ_DIRECTION_ALL);
            avr_irq_register_notify(directions, on_directions, (void *)&pads[i].port);
        }
    }
}
#else
static void connect_pads(void) {
}
#endif

void reset_plant(void) {
    move_on();
    for (int c = 0; c < HAPSIM_BOARD_CHANNELS; c++) {
        channels[c].high = false;
        channels[c].forward = !FORWARD_HIGH;
        channels[c].edge = chip->cycle;
        set_duty(&channels[c], chip->cycle, 0);
    }
}

void connect_plant(avr_t *avr, void (*note)(uint64_t cycle, int32_t duty)) {
    chip = avr;
    note_drive = note;
    seed = 88172645463325252ull ^ (uint64_t)random_seed << 20;
    avr->avcc = 1023; /* mV: one per count */
    converter = avr_io_getirq(avr, AVR_IOCTL_ADC_GETIRQ, 0);
    avr_irq_register_notify(converter + ADC_IRQ_OUT_TRIGGER, on_conversion, NULL);
    avr_irq_register_notify(avr_get_interrupt_irq(avr, COMPARE_B) + AVR_INT_IRQ_PENDING, on_match, NULL);
    for (int c = 0; c < HAPSIM_BOARD_CHANNELS; c++) {
        avr_irq_register_notify(pin(motors[c].pwm_port, motors[c].pwm), on_pwm, &channels[c]);
        avr_irq_register_notify(pin(motors[c].direction_port, motors[c].direction), on_direction, &channels[c]);
    }
    connect_pads();
    reset_plant();
}
