#include "noise.h"

#include <math.h>
#include <stdlib.h>

/* The flattest tenth of the cells shows how much noise there is at most ... */
#define FLATTEST_SHARE 0.1

/* ... of those with so much of their weight neither black nor saturated, and with so much noise expected (squared grey
 * levels): what is clipped shows no noise, and rounding hides less than half a grey level of it. */
#define LEAST_READABLE 0.5
#define LEAST_VARIANCE 0.25

static int ascending(const void *a, const void *b)
{
    const double x = *(const double *)a, y = *(const double *)b;
    return (x > y) - (x < y);
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
