/* SPDX-License-Identifier: MIT */
/* The plant at the pins of an emulated analogue board: a motor on its bridge, a moving mass with friction, a sensor. */
#ifndef PLANT_H
#define PLANT_H

#include <sim_avr.h>
#include <stdbool.h>
#include <stdint.h>

/* Takes NAME=NUMBER, one of the properties in plant.c; returns false for another name. Call it before connect_plant. */
bool set_plant(const char *word);

/* Connects the plant to the converter's inputs and the motors' pins. Calls `note` for each change of channel 0's drive,
 * with the cycle from which it acts and the duty in 256ths. The duty is negative towards smaller positions. */
void connect_plant(avr_t *avr, void (*note)(uint64_t cycle, int32_t duty));

/* Call it when the chip was reset: its pins drive nothing. */
void reset_plant(void);

/* Prints the present properties. */
void tell_plant(void);

#endif
