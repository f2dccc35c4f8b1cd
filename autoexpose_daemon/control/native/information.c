#include "information.h"

#include <math.h>
#include <stdlib.h>

#include "noise.h"
#include "vectorised.h"

enum { TILE = 8 };

/* As in information.py. */
#define FLATTEST_SHARE 0.1
#define LEAST_READABLE 0.5
#define LEAST_VARIANCE 0.25

/* Rows of exposures have the length `padded`, the least multiple of TILE. */
typedef struct {
    size_t bins, exposures, padded;
    double *noise;            /* [bin], of the present image */
    double *signal;           /* [cell][bin], energy of gradients without that of noise */
    double *variance, *worth; /* [bin][exposure] */
    double *information;      /* [cell][exposure] */
} Tables;

static int ascending(const void *a, const void *b)
{
    const double x = *(const double *)a, y = *(const double *)b;
    return (x > y) - (x < y);
}

static Cell cell_of(const Prediction *prediction, const double *noise, const double *energy, const double *count)
{
    Cell sums = {0.0, 0.0, 0.0, 0.0};
    for (size_t bin = 0; bin < prediction->bins; bin++) {
        const double readable = prediction->readable[bin];
        sums.shown += energy[bin] / 4 * readable;
        sums.expected += count[bin] * (noise[bin] * readable);
        sums.readable += count[bin] * readable;
        sums.weight += count[bin];
    }
    return sums;
}

double share_of_noise(const Cell cells[ALL_CELLS])
{
    double shares[ALL_CELLS];
    size_t telling = 0;
    for (const Cell *cell = cells; cell < cells + ALL_CELLS; cell++)
        if (cell->readable > LEAST_READABLE * cell->weight && cell->expected > LEAST_VARIANCE * cell->readable)
            shares[telling++] = cell->shown / cell->expected;
    if (!telling)
        return 1.0;
    qsort(shares, telling, sizeof *shares, ascending);
    const double rank = FLATTEST_SHARE * (double)(telling - 1);
    const size_t below = (size_t)rank;
    const double rise = below + 1 < telling ? shares[below + 1] - shares[below] : 0.0;
    return fmin(shares[below] + rise * (rank - (double)below), 1.0);
}

VECTORISED static void subtract_noise(const Tables *tables, double share, const double *energy, const double *count)
{
    double *restrict signal = tables->signal;
    for (size_t cell = 0; cell < ALL_CELLS; cell++, energy += tables->bins, count += tables->bins, signal += tables->bins)
        for (size_t bin = 0; bin < tables->bins; bin++)
            signal[bin] = energy[bin] / 4 - count[bin] * (share * tables->noise[bin]);
}

/* Of photons and read noise. */
VECTORISED static void predict_variance(const Tables *tables, const Prediction *prediction, const Exposures *taken,
                                        double share)
{
    const double factor = share / taken->pixels;
    for (size_t bin = 0; bin < tables->bins; bin++) {
        const double *shot = prediction->shot + bin * tables->exposures;
        const double *read = prediction->read + bin * tables->exposures;
        double *restrict variance = tables->variance + bin * tables->padded;
        for (size_t i = 0; i < tables->exposures; i++)
            variance[i] = shot[i] * (factor * taken->gains[i]) + read[i] * (factor * (taken->gains[i] * taken->gains[i]));
    }
}

/* What a squared grey level of contrast tells, with so much lost besides noise. */
VECTORISED static void find_worth(const Tables *tables, const Prediction *prediction, double lost)
{
    for (size_t bin = 0; bin < tables->bins; bin++) {
        const double *contrast = prediction->contrast + bin * tables->exposures;
        const double *variance = tables->variance + bin * tables->padded;
        double *restrict worth = tables->worth + bin * tables->padded;
        for (size_t i = 0; i < tables->exposures; i++)
            worth[i] = contrast[i] / (variance[i] + lost);
    }
}

/* The information of a cell at each exposure: rows are a multiple of TILE, which compilers unroll. */
VECTORISED static void inform(const Tables *tables, size_t cell)
{
    const double *signal = tables->signal + cell * tables->bins, *worth = tables->worth;
    double *restrict information = tables->information + cell * tables->padded;
    for (size_t bin = 0; bin < tables->bins; bin++, worth += tables->padded) {
        const double energy = signal[bin];
        if (energy == 0.0)
            continue;
        for (size_t first = 0; first < tables->padded; first += TILE)
            for (size_t i = 0; i < TILE; i++)
                information[first + i] += energy * worth[first + i];
    }
}

/* Each light that a cell gets has a table of worths. */
static void inform_cells(const Tables *tables, const Prediction *prediction, const double *light, double rounding)
{
    char informed[ALL_CELLS] = {0};
    for (size_t first = 0; first < ALL_CELLS; first++) {
        if (informed[first])
            continue;
        const double front_end = light ? FRONT_END_DN * light[first] : FRONT_END_DN;
        find_worth(tables, prediction, rounding + front_end * front_end);
        for (size_t cell = first; cell < ALL_CELLS; cell++)
            if (!light || light[cell] == light[first]) {
                inform(tables, cell);
                informed[cell] = 1;
            }
    }
}

/* Sums the roots of the cells' information, their mean pixel being the unit, each times its weight if there are some. */
VECTORISED static void add_roots(const Tables *tables, double unit, const double *weights, double *restrict curve)
{
    for (size_t cell = 0; cell < ALL_CELLS; cell++) {
        const double *information = tables->information + cell * tables->padded, weight = weights ? weights[cell] : 1.0;
        for (size_t i = 0; i < tables->exposures; i++)
            curve[i] += weight * sqrt((information[i] > 0.0 ? information[i] : 0.0) * unit);
    }
}

static void finish(const Tables *tables, const Exposures *taken, const Cell cells[ALL_CELLS], const double *weights,
                   double *curve)
{
    double weight = 0.0, seen = 0.0, total = 0.0;
    for (size_t cell = 0; cell < ALL_CELLS; cell++) {
        weight += cells[cell].weight;
        seen += cells[cell].weight > 0.0;
        if (cells[cell].weight > 0.0)
            total += weights ? weights[cell] : 1.0;
    }
    for (size_t i = 0; i < tables->exposures; i++)
        curve[i] = 0.0;
    add_roots(tables, fmax(seen, 1.0) / fmax(weight, 1.0), weights, curve);
    for (size_t i = 0; i < tables->exposures; i++)
        curve[i] = curve[i] / (total == 0.0 ? 1.0 : total) * sqrt(taken->sharper[i]);
}

static void predict(const Tables *tables, const Prediction *prediction, const Exposures *taken, const double *energy,
                    const double *count, double *curve, double *steered)
{
    Cell cells[ALL_CELLS];
    for (size_t bin = 0; bin < tables->bins; bin++)
        tables->noise[bin] = variance_of(prediction->shot_now[bin] * taken->gain +
                                             prediction->read_now[bin] * (taken->gain * taken->gain),
                                         taken->pixels);
    for (size_t cell = 0; cell < ALL_CELLS; cell++)
        cells[cell] = cell_of(prediction, tables->noise, energy + cell * tables->bins, count + cell * tables->bins);
    const double share = share_of_noise(cells);
    subtract_noise(tables, share, energy, count);
    predict_variance(tables, prediction, taken, share);
    inform_cells(tables, prediction, taken->relative_light, share * variance_of(0.0, taken->pixels));
    finish(tables, taken, cells, NULL, curve);
    if (steered)
        finish(tables, taken, cells, taken->cell_weights, steered);
}

int predict_information(const Prediction *prediction, const Exposures *taken, const double *energy,
                        const double *count, double *curve, double *steered)
{
    const size_t bins = prediction->bins, padded = (prediction->exposures + TILE - 1) / TILE * TILE;
    const size_t table = bins * padded;
    double *noise = calloc(bins + ALL_CELLS * bins + 2 * table + ALL_CELLS * padded, sizeof *noise);
    if (!noise)
        return -1;
    const Tables tables = {.bins = bins,
                           .exposures = prediction->exposures,
                           .padded = padded,
                           .noise = noise,
                           .signal = noise + bins,
                           .variance = noise + bins + ALL_CELLS * bins,
                           .worth = noise + bins + ALL_CELLS * bins + table,
                           .information = noise + bins + ALL_CELLS * bins + 2 * table};
    predict(&tables, prediction, taken, energy, count, curve, steered);
    free(noise);
    return 0;
}
