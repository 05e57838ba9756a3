/* SPDX-License-Identifier: MIT */
/* STM32 (Cortex-M3 upwards, STM32duino): a timer's interrupt makes the tick; the independent watchdog resets the
 * chip. */
#ifdef ARDUINO_ARCH_STM32
#include "hapsim_knob.h"

#include <IWatchdog.h>

#include "hapsim_board.h"
#include "hapsim_platform.h"

static HardwareTimer timer(HAPSIM_KNOB_TIMER);

void hapsim_platform_begin(uint32_t period_us) {
    timer.setOverflow(period_us, MICROSEC_FORMAT);
    timer.attachInterrupt(hapsim_knob_tick);
    timer.resume();
    IWatchdog.begin(HAPSIM_WATCHDOG_MS * 1000);
}

void hapsim_platform_restart(uint32_t) {
    timer.setCount(0);
}

void hapsim_platform_feed_watchdog() {
    IWatchdog.reload();
}
#endif
