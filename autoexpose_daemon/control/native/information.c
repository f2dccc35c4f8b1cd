#include "information.h"

#include <math.h>
#include <stdlib.h>

#include "contrast.h"
#include "noise.h"
#include "vectorised.h"

enum { ALL = CELLS * CELLS };

/* As in information.py. */
#define FLATTEST_SHARE 0.1
#define LEAST_READABLE 0.5
#define LEAST_VARIANCE 0.25

static int ascending(const void *a, const void *b)
{
    const double x = *(const double *)a, y = *(const double *)b;
    return (x > y) - (x < y);
}

/* The actual noise as a share of that expected in each bin, `noise`: what the flattest cells show. */
static double share_of_noise(const Prediction *prediction, const double *noise, const double *energy,
                             const double *count, const double *by_cell)
{
    double shares[ALL];
    size_t telling = 0;
    for (size_t cell = 0; cell < ALL; cell++) {
        double shown = 0.0, expected = 0.0, weight = 0.0;
        for (size_t bin = 0; bin < prediction->bins; bin++, energy++, count++) {
            const double readable = prediction->readable[bin];
            shown += *energy / 4 * readable;
            expected += noise[bin] * *count * readable;
            weight += *count * readable;
        }
        if (weight > LEAST_READABLE * by_cell[cell] && expected > LEAST_VARIANCE * weight)
            shares[telling++] = shown / expected;
    }
    if (!telling)
        return 1.0;
    qsort(shares, telling, sizeof *shares, ascending);
    const double rank = FLATTEST_SHARE * (double)(telling - 1);
    const size_t below = (size_t)rank;
    const double rise = below + 1 < telling ? shares[below + 1] - shares[below] : 0.0;
    return fmin(shares[below] + rise * (rank - (double)below), 1.0);
}

/* The variance of noise by bin and exposure, without that of rounding. */
VECTORISED static void noise_of(const Prediction *prediction, const Exposures *taken, double share,
                                double *restrict variance)
{
    const double *shot = prediction->shot, *read = prediction->read, *gains = taken->gains;
    const double factor = share / taken->pixels;
    for (size_t bin = 0; bin < prediction->bins; bin++)
        for (size_t i = 0; i < prediction->exposures; i++, shot++, read++)
            *variance++ = *shot * (factor * gains[i]) + *read * (factor * (gains[i] * gains[i]));
}

/* What a squared grey level of contrast is worth by bin and exposure, with so much variance besides noise. */
VECTORISED static void worth_of(const Prediction *prediction, const double *variance, double besides,
                                double *restrict worth)
{
    const double *contrast = prediction->contrast;
    for (size_t place = 0; place < prediction->bins * prediction->exposures; place++)
        worth[place] = contrast[place] / (variance[place] + besides);
}

VECTORISED static void inform(const Prediction *prediction, const double *restrict signal, const double *worth,
                              double *restrict information)
{
    for (size_t bin = 0; bin < prediction->bins; bin++, worth += prediction->exposures)
        for (size_t i = 0; signal[bin] != 0.0 && i < prediction->exposures; i++)
            information[i] += signal[bin] * worth[i];
}

/* The information of each cell at each exposure, added to `information`. `worth` is room for a table. */
static void inform_cells(const Prediction *prediction, const Exposures *taken, const double *variance,
                         double rounding, const double *signal, double *worth, double *information)
{
    const double *light = taken->relative_light;
    char informed[ALL] = {0};
    for (size_t first = 0; first < ALL; first++) {
        if (informed[first])
            continue;
        const double lost = light ? FRONT_END_DN * light[first] : FRONT_END_DN;
        worth_of(prediction, variance, rounding + lost * lost, worth);
        for (size_t cell = first; cell < ALL; cell++)
            if (!light || light[cell] == light[first]) {
                inform(prediction, signal + cell * prediction->bins, worth, information + cell * prediction->exposures);
                informed[cell] = 1;
            }
    }
}

/* Replaces information by its roots, with the mean pixel of a cell as their unit, and sums them over cells. */
VECTORISED static void sum_roots(size_t exposures, double scale, const double *cell_weights,
                                 double *restrict information, double *restrict curve, double *restrict steered)
{
    for (size_t cell = 0; cell < ALL; cell++, information += exposures) {
        for (size_t i = 0; i < exposures; i++) {
            information[i] = sqrt((information[i] > 0.0 ? information[i] : 0.0) * scale);
            curve[i] += information[i];
        }
        for (size_t i = 0; cell_weights && i < exposures; i++)
            steered[i] += cell_weights[cell] * information[i];
    }
}

static void sum_cells(const Prediction *prediction, const Exposures *taken, double *information,
                      const double *by_cell, double *curve, double *steered)
{
    const size_t exposures = prediction->exposures;
    double weight = 0.0, cells = 0.0, of_weights = 0.0;
    for (size_t cell = 0; cell < ALL; cell++) {
        weight += by_cell[cell];
        cells += by_cell[cell] > 0.0;
        of_weights += by_cell[cell] > 0.0 && taken->cell_weights ? taken->cell_weights[cell] : 0.0;
    }
    cells = fmax(cells, 1.0);
    for (size_t i = 0; i < exposures; i++)
        curve[i] = 0.0;
    for (size_t i = 0; steered && i < exposures; i++)
        steered[i] = 0.0;
    sum_roots(exposures, cells / fmax(weight, 1.0), taken->cell_weights, information, curve, steered);
    for (size_t i = 0; i < exposures; i++)
        curve[i] = curve[i] / cells * sqrt(taken->sharper[i]);
    for (size_t i = 0; steered && i < exposures; i++)
        steered[i] = steered[i] / (of_weights == 0.0 ? 1.0 : of_weights) * sqrt(taken->sharper[i]);
}

/* The gradients' energy without that of noise, whose variance is given by bin. */
VECTORISED static void without_noise(size_t bins, const double *energy, const double *count, const double *noise,
                                     double share, double *restrict signal)
{
    for (size_t cell = 0; cell < ALL; cell++, energy += bins, count += bins, signal += bins)
        for (size_t bin = 0; bin < bins; bin++)
            signal[bin] = energy[bin] / 4 - share * (noise[bin] * count[bin]);
}

int predict_information(const Prediction *prediction, const Exposures *taken, const double *energy,
                        const double *count, double *curve, double *steered)
{
    const size_t bins = prediction->bins, table = bins * prediction->exposures;
    double by_cell[ALL] = {0.0};
    double *noise = calloc(bins + ALL * bins + 2 * table + ALL * prediction->exposures, sizeof *noise);
    if (!noise)
        return -1;
    double *signal = noise + bins, *variance = signal + ALL * bins, *worth = variance + table,
           *information = worth + table;
    for (size_t bin = 0; bin < bins; bin++)
        noise[bin] = variance_of(prediction->shot_now[bin] * taken->gain +
                                     prediction->read_now[bin] * (taken->gain * taken->gain),
                                 taken->pixels);
    for (size_t cell = 0; cell < ALL; cell++)
        for (size_t bin = 0; bin < bins; bin++)
            by_cell[cell] += count[cell * bins + bin];
    const double share = share_of_noise(prediction, noise, energy, count, by_cell);
    without_noise(bins, energy, count, noise, share, signal);
    noise_of(prediction, taken, share, variance);
    inform_cells(prediction, taken, variance, share * variance_of(0.0, taken->pixels), signal, worth, information);
    sum_cells(prediction, taken, information, by_cell, curve, steered);
    free(noise);
    return 0;
}
