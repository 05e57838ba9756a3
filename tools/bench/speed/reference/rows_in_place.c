/* A string of equal masses between two fixed ends, in two rows of positions: x[n+1] goes where x[n-1] was.
 *
 *     cc -O3 -march=native -mprefer-vector-width=512 -ffp-contract=fast -fPIC -shared rows_in_place.c
 *
 * The recurrence of `stencil.c`. What a mass asks of its neighbours, t = side x - old_side x-, is worked out once, eight
 * masses at a time, and handed from block to block, so that x- of a neighbour is read before it is overwritten.
 */
#include <stdint.h>
#ifdef __SSE__
#include <xmmintrin.h>
#endif

typedef double lanes __attribute__((vector_size(64)));
enum { WIDTH = 8 };

/* Rows begin on a multiple of 64 bytes: 8 borders, the masses, and borders up to the end of the next block; all borders
 * are at 0 for ever. `rows[turn]` is x[n], the other one x[n-1]; m. */
struct string {
    double *rows[2];
    double centre, side, old_centre, old_side; /* as in stencil.c */
    double mobility;                           /* T²/m, m/N */
    double hand_stiffness, hand_damping;       /* K and B/T of the link from the hand to a mass, N/m */
    double hand_before;                        /* where the hand was, m */
    int64_t held;                              /* the mass that it holds, from 0 */
    int64_t masses;
    int64_t turn;
};

static inline lanes at(const double *row) { return *(const lanes *)row; }

static void advance(const struct string *s, const double *restrict x, double *restrict before) {
    const double centre = s->centre, side = s->side, old_centre = s->old_centre, old_side = s->old_side;
    lanes here = at(x), here_before = at(before);
    lanes left = side * at(x - WIDTH) - old_side * at(before - WIDTH), middle = side * here - old_side * here_before;
    for (int64_t i = 0; i < s->masses; i += WIDTH) {
        const lanes next = at(x + i + WIDTH), next_before = at(before + i + WIDTH);
        const lanes right = side * next - old_side * next_before;
        const lanes from_left = __builtin_shufflevector(left, middle, 7, 8, 9, 10, 11, 12, 13, 14);
        const lanes from_right = __builtin_shufflevector(middle, right, 1, 2, 3, 4, 5, 6, 7, 8);
        *(lanes *)(before + i) = (centre * here - old_centre * here_before) + (from_left + from_right);
        left = middle, middle = right, here = next, here_before = next_before;
    }
    for (int64_t i = s->masses; i % WIDTH; i++)
        before[i] = 0.0;
}

/* Each sample reads where the hand is (m) and gives the force on it back (N). */
void rows_in_place_run(struct string *s, int64_t samples, const double *hand, double *forces) {
    for (int64_t n = 0; n < samples; n++) {
        double *x = s->rows[s->turn] + WIDTH, *before = s->rows[1 - s->turn] + WIDTH;
        const double stretch = hand[n] - x[s->held];
        const double pull =
            s->hand_stiffness * stretch + s->hand_damping * (stretch - (s->hand_before - before[s->held]));
        s->hand_before = hand[n];
        forces[n] = -pull;
        advance(s, x, before);
        before[s->held] += s->mobility * pull;
        s->turn = 1 - s->turn;
    }
}

/* Denormals count as zero in this thread, or not. */
void flush_denormals(int on) {
#ifdef __SSE__
    const unsigned bits = 0x8040;
    _mm_setcsr(on ? _mm_getcsr() | bits : _mm_getcsr() & ~bits);
#endif
}
