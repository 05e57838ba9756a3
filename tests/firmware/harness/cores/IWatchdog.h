/* STM32duino's declarations, as far as the knob uses them. */
#pragma once
#include <stdint.h>

struct TIM_TypeDef;
#define TIM6 ((TIM_TypeDef *)0x40001000)
typedef enum { TICK_FORMAT, MICROSEC_FORMAT, HERTZ_FORMAT } TimerFormat_t;
class HardwareTimer {
public:
    HardwareTimer(TIM_TypeDef *instance);
    void resume();
    void setOverflow(uint32_t value, TimerFormat_t format = TICK_FORMAT);
    void setCount(uint32_t value, TimerFormat_t format = TICK_FORMAT);
    void attachInterrupt(void (*callback)());
};
class IWatchdogClass {
public:
    void begin(uint32_t timeout_us, uint32_t window = 0);
    void reload();
};
extern IWatchdogClass IWatchdog;
