#include "sightings.h"

#include <math.h>

/* As in memory.py. */
#define BLINDNESS 3.0
#define TRUSTED_RISE 3.0
#define NEARER_UP 0.4
#define FARTHER_BEYOND 2.0
#define DOUBT 0.5

/* The interval of the curves in which a change of level lies, and where in it, 0 to 1. */
static size_t place_of(const Sightings *seen, double change, double *share)
{
    const double within = fmin(fmax(change, seen->delta[0]), seen->delta[seen->deltas - 1]);
    size_t before = 0;
    while (before + 2 < seen->deltas && seen->delta[before + 1] <= within)
        before++;
    *share = (within - seen->delta[before]) / (seen->delta[before + 1] - seen->delta[before]);
    return before;
}

void predict_metrics(const Sightings *seen, const double *levels, size_t count, int doubting, double *values,
                     double *distances)
{
    for (size_t sighting = 0; sighting < seen->count; sighting++)
        for (size_t i = 0; i < count; i++) {
            const double change = levels[i] - seen->levels[sighting], beyond = fmax(change - TRUSTED_RISE, 0.0);
            const double up = NEARER_UP * fmin(fmax(change, 0.0), TRUSTED_RISE) + FARTHER_BEYOND * beyond +
                              seen->ages[sighting];
            const double believed = doubting ? exp(-DOUBT * beyond) : 1.0;
            double share;
            const size_t before = place_of(seen, change, &share);
            for (size_t camera = 0; camera < seen->cameras; camera++) {
                const size_t view = sighting * seen->cameras + camera;
                const double *curve = seen->curves + view * seen->deltas + before;
                values[view * count + i] = (curve[0] + share * (curve[1] - curve[0])) * believed;
                distances[view * count + i] = up + fmax(-change, 0.0) * (1.0 + BLINDNESS * seen->blind[view]);
            }
        }
}
