/* The smallest tick: a hand on a spring and damper to the ground.
 *
 *     cc -O3 -march=native -ffp-contract=fast -fPIC -shared spring.c
 *
 * Every value stands in memory, as in a program that reads a scene and lets it be edited. In a loop against a device
 * each tick finds its values there anew and leaves its own there; spring_run keeps to that with a barrier to the
 * compiler behind each tick. spring_run_called has its scene behind a pointer as well, as a program has that is compiled
 * once for every scene. spring_run_free lets the compiler do what it can over many ticks at once, which no device lets
 * a program do.
 */
#include <stdint.h>

struct spring {
    double hand;               /* where it was at the last tick, m */
    double ground;             /* m */
    double stiffness;          /* K, N/m */
    double damping_per_sample; /* B/T, N/m */
};

/* The force on the hand, N, that is now at `measured`. */
static inline double tick(struct spring *s, double measured) {
    const double growth = measured - s->hand;
    s->hand = measured;
    return -(s->stiffness * (measured - s->ground) + s->damping_per_sample * growth);
}

/* So many samples; the hand moves as `hand` says (m, `block` of them), over and over. Forces in N, beside it. */
void spring_run(struct spring *s, int64_t samples, int64_t block, const double *hand, double *forces) {
    for (int64_t begin = 0; begin < samples; begin += block) {
        const int64_t end = samples - begin < block ? samples - begin : block;
        for (int64_t n = 0; n < end; n++) {
            forces[n] = tick(s, hand[n]);
            __asm__ volatile("" ::: "memory");
        }
    }
}

static void tick_and_leave(struct spring *s, const double *measured, double *force) { *force = tick(s, *measured); }

static void (*volatile scene)(struct spring *, const double *, double *) = tick_and_leave;

void spring_run_called(struct spring *s, int64_t samples, int64_t block, const double *hand, double *forces) {
    for (int64_t begin = 0; begin < samples; begin += block) {
        const int64_t end = samples - begin < block ? samples - begin : block;
        for (int64_t n = 0; n < end; n++)
            scene(s, &hand[n], &forces[n]);
    }
}

void spring_run_free(struct spring *restrict s, int64_t samples, int64_t block, const double *restrict hand,
                     double *restrict forces) {
    for (int64_t begin = 0; begin < samples; begin += block) {
        const int64_t end = samples - begin < block ? samples - begin : block;
        for (int64_t n = 0; n < end; n++)
            forces[n] = tick(s, hand[n]);
    }
}
