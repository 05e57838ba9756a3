/* SPDX-License-Identifier: MIT */
/* From reset to main: sets up memory as C expects it, and defines the vectors. */
#include <stdint.h>

int main(void);
void on_systick(void);
void on_pendsv(void) __attribute__((weak)); /* of a board that follows lines */
void on_uart0_received(void);
void on_uart0_sent(void);
void on_timer1(void);
void reset(void);

typedef void (*vector)(void);

extern const vector constructors_begin, constructors_end; /* of C++ */
extern uint32_t data_begin, data_end, data_in_flash, bss_begin, bss_end, stack_top;

void reset(void) {
    const uint32_t *from = &data_in_flash;
    for (uint32_t *to = &data_begin; to < &data_end;) {
        *to++ = *from++;
    }
    for (uint32_t *to = &bss_begin; to < &bss_end;) {
        *to++ = 0;
    }
    for (const vector *constructor = &constructors_begin; constructor < &constructors_end; constructor++) {
        (*constructor)();
    }
    main();
}

/* The handler of a fault, or of the watchdog's warning: waits here until the watchdog resets the chip. */
static void stay(void) {
    for (;;) {
    }
}

typedef struct {
    uint32_t *stack;
    vector handlers[31];
} vector_table;

__attribute__((section(".vectors"), used)) const vector_table vectors = {
    &stack_top,
    {reset, stay, stay, stay, stay, stay, 0, 0, 0, 0, stay, stay, 0, on_pendsv, on_systick, on_uart0_received, on_uart0_sent,
     stay, stay, stay, stay, stay, stay, stay, on_timer1},
};
