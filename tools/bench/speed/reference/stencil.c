/* A string of equal masses between two fixed ends, and nothing else: what a program for one object can do.
 *
 *     cc -O3 -march=native -fPIC -shared stencil.c
 *     cc -DMASSES=100 -O3 -march=native -mprefer-vector-width=512 -ffp-contract=fast -fPIC -shared stencil.c
 *
 * The centred scheme of CORDIS, dampers by backward difference, both written out in positions:
 *
 *     x[n+1] = 2 x - x- + (T²/m) (K L x + (B/T) (L x - L x-)),   (L x)_i = x_{i-1} - 2 x_i + x_{i+1}
 *
 * so that the next row comes from the two before it with four constants, and three rows take turns. With MASSES the
 * number of masses is the compiler's to know: short strings are unrolled whole.
 */
#include <stdint.h>

#ifdef MASSES
#define COUNT(s) MASSES
#else
#define COUNT(s) ((s)->masses)
#endif

#define INLINE static inline __attribute__((always_inline))

/* Rows hold `masses` + 2 points, the first and the last at 0 for ever; m. */
struct stencil {
    double *now;
    double *before;
    double *next;
    double centre;         /* 2 - 2 (T²/m) (K + B/T) */
    double side;           /* (T²/m) (K + B/T) */
    double old_centre;     /* 1 - 2 (T²/m) (B/T) */
    double old_side;       /* (T²/m) (B/T) */
    double mobility;       /* T²/m, m/N */
    double hand_stiffness; /* K of the link from the hand to a mass, N/m */
    double hand_damping;   /* B/T of it, N/m */
    double hand_before;    /* where the hand was, m */
    int64_t held;          /* the point that it holds, 1 to `masses` */
    int64_t masses;
};

INLINE void advance(const struct stencil *s, const double *restrict now, const double *restrict before,
                    double *restrict next) {
    const double centre = s->centre, side = s->side, old_centre = s->old_centre, old_side = s->old_side;
    const int64_t masses = COUNT(s);
    for (int64_t i = 1; i <= masses; i++)
        next[i] = centre * now[i] + side * (now[i - 1] + now[i + 1]) - old_centre * before[i] -
                  old_side * (before[i - 1] + before[i + 1]);
}

INLINE void run(struct stencil *s, int64_t samples, const double *restrict hand, double *restrict forces, int held) {
    const struct stencil constants = *s;
    const int64_t at = constants.held;
    double *now = s->now, *before = s->before, *next = s->next;
    double hand_before = s->hand_before;
    for (int64_t n = 0; n < samples; n++) {
        double pull = 0.0;
        if (held) {
            const double stretch = hand[n] - now[at];
            const double growth = stretch - (hand_before - before[at]);
            pull = constants.hand_stiffness * stretch + constants.hand_damping * growth;
            hand_before = hand[n];
            forces[n] = -pull;
        }
        advance(&constants, now, before, next);
        if (held)
            next[at] += constants.mobility * pull;
        double *free_row = before;
        before = now;
        now = next;
        next = free_row;
    }
    s->now = now;
    s->before = before;
    s->next = next;
    s->hand_before = hand_before;
}

/* Each sample reads where the hand is (m) and gives the force on it back (N). */
void stencil_run(struct stencil *s, int64_t samples, const double *hand, double *forces) {
    run(s, samples, hand, forces, 1);
}

/* The string alone. */
void stencil_run_alone(struct stencil *s, int64_t samples) { run(s, samples, 0, 0, 0); }
