/* SPDX-License-Identifier: MIT */
/* The chip's part of hapsim_knob.cpp: a timer that calls hapsim_knob_tick, and a watchdog that resets the chip. */
#ifndef HAPSIM_PLATFORM_H
#define HAPSIM_PLATFORM_H

#include <stdint.h>

enum : uint32_t { HAPSIM_WATCHDOG_MS = 30 };

/* Starts the timer and the watchdog. */
void hapsim_platform_begin(uint32_t period_us);

/* Restarts the timer: the next tick comes a whole period from now. */
void hapsim_platform_restart(uint32_t period_us);

void hapsim_platform_feed_watchdog();

#endif
