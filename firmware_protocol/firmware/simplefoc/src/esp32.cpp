/* SPDX-License-Identifier: MIT */
/* ESP32 (Arduino core 3): the task of esp_timer (priority 22) makes the tick; the task watchdog resets the chip. */
#ifdef ARDUINO_ARCH_ESP32
#include <esp_task_wdt.h>
#include <esp_timer.h>

#include "hapsim_knob.h"
#include "hapsim_platform.h"

static esp_timer_handle_t timer;
static esp_task_wdt_user_handle_t watchdog;

static void on_timer(void *) {
    hapsim_knob_tick();
}

/* The core may have started the watchdog already, with another timeout. */
static void start_watchdog() {
    esp_task_wdt_config_t config = {};
    config.timeout_ms = HAPSIM_WATCHDOG_MS;
    config.trigger_panic = true;
    if (esp_task_wdt_init(&config) != ESP_OK) {
        ESP_ERROR_CHECK(esp_task_wdt_reconfigure(&config));
    }
    ESP_ERROR_CHECK(esp_task_wdt_add_user("hapsim", &watchdog));
}

void hapsim_platform_begin(uint32_t period_us) {
    esp_timer_create_args_t arguments = {};
    arguments.callback = on_timer;
    arguments.name = "hapsim";
    arguments.skip_unhandled_events = true; /* no burst of ticks */
    start_watchdog();
    ESP_ERROR_CHECK(esp_timer_create(&arguments, &timer));
    ESP_ERROR_CHECK(esp_timer_start_periodic(timer, period_us));
}

void hapsim_platform_restart(uint32_t period_us) {
    ESP_ERROR_CHECK(esp_timer_restart(timer, period_us));
}

void hapsim_platform_feed_watchdog() {
    esp_task_wdt_reset_user(watchdog);
}
#endif
