/* SPDX-License-Identifier: MIT */
/* The plant at the pins of an emulated analogue board: a motor on its bridge, a moving mass with friction, a sensor. */
#ifndef PLANT_H
#define PLANT_H

#include <sim_avr.h>
#include <stdbool.h>
#include <stdint.h>

/* Takes NAME=NUMBER, one of the properties in plant.c; returns false for another name. Call it before connect_plant. */
bool set_plant(const char *word);

/* Joins the converter's inputs and the motors' pins. `note`: called for each change of a motor's drive with the cycle from
 * which it acts, and the drive of channel 0: its duty in 256ths, below zero where it pushes towards smaller positions. */
void connect_plant(avr_t *avr, void (*note)(uint64_t cycle, int32_t duty));

/* The chip was reset: its pins drive nothing. */
void reset_plant(void);

/* The properties in force. */
void tell_plant(void);

#endif
