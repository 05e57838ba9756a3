/* Any network of masses and visco-elastic links: one pass over the links, one over the masses.
 *
 *     cc -O3 -march=native -mprefer-vector-width=512 -ffp-contract=fast -fPIC -shared network.c
 *
 * Point 0 is the hand, then come the points that stay, then the masses. The centred scheme of CORDIS, the damper a
 * backward difference:
 *
 *     F[n] = K d[n] + (B/T) (d[n] - d[n-1]),   x[n+1] = 2 x[n] - x[n-1] + (T²/m) F[n]
 *
 * The links' forces are scattered one by one. Computing them in a loop of its own, which the compiler vectorises with
 * gathers, was tried and is no faster.
 */
#include <stdint.h>
#include <string.h>

struct network {
    int64_t points;
    int64_t links;
    int64_t masses;
    int64_t first_mass;               /* the point that the masses begin at */
    const uint32_t *first;            /* the points that each link joins */
    const uint32_t *second;
    const double *stiffness;          /* K, N/m */
    const double *damping_per_sample; /* B/T, N/m */
    const double *mobility;           /* T²/m of each mass, m/N */
    double *position;                 /* m, one for each point */
    double *previous;
    double *force; /* N */
};

static inline void pull(int64_t links, const uint32_t *restrict first, const uint32_t *restrict second,
                        const double *restrict stiffness, const double *restrict damping_per_sample,
                        const double *restrict position, const double *restrict previous, double *restrict force) {
    for (int64_t i = 0; i < links; i++) {
        const uint32_t a = first[i], b = second[i];
        const double stretch = position[a] - position[b];
        const double growth = stretch - (previous[a] - previous[b]);
        const double f = stiffness[i] * stretch + damping_per_sample[i] * growth;
        force[a] -= f;
        force[b] += f;
    }
}

static inline void advance(int64_t masses, const double *restrict mobility, const double *restrict force,
                           double *restrict position, double *restrict previous) {
    for (int64_t i = 0; i < masses; i++) {
        const double now = position[i];
        position[i] = 2.0 * now - previous[i] + mobility[i] * force[i];
        previous[i] = now;
    }
}

/* Each sample reads where the hand is (m) and gives the force on it back (N). */
void network_run(struct network *w, int64_t samples, const double *hand, double *forces) {
    const struct network net = *w;
    const int64_t m = net.first_mass;
    for (int64_t n = 0; n < samples; n++) {
        net.previous[0] = net.position[0];
        net.position[0] = hand[n];
        memset(net.force, 0, (size_t)net.points * sizeof(double));
        pull(net.links, net.first, net.second, net.stiffness, net.damping_per_sample, net.position, net.previous,
             net.force);
        forces[n] = net.force[0];
        advance(net.masses, net.mobility, net.force + m, net.position + m, net.previous + m);
    }
}
