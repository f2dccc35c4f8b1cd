/* Where the light may be that a camera has not been shown: what is clipped, and not remembered. */
#ifndef AUTOEXPOSE_HIDDEN_H
#define AUTOEXPOSE_HIDDEN_H

#include "belief.h"

enum { DARK, BRIGHT };

/* What is divided by is at least this. */
#define LEAST_PIXELS 1e-9

/* Bins from `first` up to `end`. */
typedef struct {
    size_t first, end;
} Bins;

/* The bins that have a part between two log radiances, those whose middles are, and those on a side of a scene's bound. */
Bins bins_between(const Rules *rules, size_t bins, double low, double high);
Bins bins_with_middles(const Rules *rules, size_t bins, double low, double high);
Bins bins_beyond(const Rules *rules, const Scene *scene, size_t side);

/* Those that have been looked at: the others hold nothing. */
Bins bins_looked_at(const Scene *scene);

Bins common(Bins one, Bins other);

/* Log radiance of the lower bound of a bin. */
static inline double edge_of(const Rules *rules, size_t bin)
{
    return rules->lowest + rules->bin * (double)bin;
}

/* Not fmax and fmin, with which compilers vectorise nothing. */
static inline double greater(double one, double other)
{
    return one > other ? one : other;
}

static inline double lesser(double one, double other)
{
    return one < other ? one : other;
}

/* Cells that are added up at once: compilers do not reorder sums. */
typedef double Lanes __attribute__((vector_size(4 * sizeof(double)), aligned(sizeof(double)), may_alias));

enum { LANES_OF_CELLS = ALL_CELLS / 4 };

static inline double sum_of_cells(const double values[ALL_CELLS])
{
    const Lanes *lanes = (const Lanes *)values;
    Lanes sum = lanes[0], other = lanes[1];
    for (size_t i = 2; i < LANES_OF_CELLS; i += 2) {
        sum += lanes[i];
        other += lanes[i + 1];
    }
    sum += other;
    return (sum[0] + sum[1]) + (sum[2] + sum[3]);
}

static inline double weighted_sum(const double values[ALL_CELLS], const double weights[ALL_CELLS])
{
    const Lanes *lanes = (const Lanes *)values, *by = (const Lanes *)weights;
    Lanes sum = lanes[0] * by[0], other = lanes[1] * by[1];
    for (size_t i = 2; i < LANES_OF_CELLS; i += 2) {
        sum += lanes[i] * by[i];
        other += lanes[i + 1] * by[i + 1];
    }
    sum += other;
    return (sum[0] + sum[1]) + (sum[2] + sum[3]);
}

/* The squared contrast of a bin's cells: what was seen, or, as far as that is unsure, what is usual. */
static inline void find_contrast(const Rules *rules, const Scene *scene, size_t bin, double *restrict known)
{
    const double *mass = scene->mass[bin], *energy = scene->energy[bin], *precision = scene->precision[bin];
    const double usual = rules->unsure / scene->usual_richness, sure = usual / scene->usual_richness;
    for (size_t cell = 0; cell < ALL_CELLS; cell++)
        known[cell] = mass[cell] * ((energy[cell] + usual) / (precision[cell] + sure));
}

/* Where one side's hidden mass lies, as far as bins are `wanted`: pixels in those before a bin, and contrast. */
typedef struct {
    Bins wanted, bins;
    double *before, (*contrast)[ALL_CELLS]; /* [bin], [bin][cell] */
} Guess;

/* The share of what is hidden that is expected to continue what is seen. */
double share_that_continues(const Rules *rules, const Scene *scene);

/* By guess 0 it continues what is seen, as far as tails reach; by the others it is detached from that. */
void guess_hidden(const Rules *rules, const Scene *scene, size_t side, size_t number, Guess *guess);

/* The chance of a guess, if there is something. */
double chance_of(size_t number, double continues);

/* Where the light of the whole picture lies, pixels and contrast, [bin]: what was seen; and in the mean over the guesses,
 * if there is something, what is hidden. Returns 0, or -1 if out of memory. */
int sum_light(const Rules *rules, const Scene *scene, double *pixels, double *contrast, double *guessed,
              double *guessed_contrast);

#endif
