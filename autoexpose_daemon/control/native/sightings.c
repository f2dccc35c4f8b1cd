#include "sightings.h"

#include <math.h>

/* As in memory.py. */
#define BLINDNESS 3.0
#define TRUSTED_RISE 3.0
#define NEARER_UP 0.4
#define FARTHER_BEYOND 2.0
#define DOUBT 0.5

/* As in search.py. */
#define LONGEST_PROBE 6.5
#define PROBE_WORTH_MOVING 1.0
#define LEAST_CAMERA 0.1
#define NOTHING 1e-9

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

/* How far a probe goes, in stops. */
static double probe_length(const Unseen *unseen, double clipped_share)
{
    return unseen->shortest + (LONGEST_PROBE - unseen->shortest) * pow(clipped_share, unseen->power);
}

/* distance: in lengths of a probe. */
static double probe_bonus(double distance, double clipped_share, double density, const Unseen *unseen)
{
    const double shape = fmin(fmax(fmin(distance, 2.0 - distance), 0.0), 1.0);
    const double worth = unseen->moving ? PROBE_WORTH_MOVING * shape : unseen->worth * sqrt(shape);
    return worth * clipped_share * density;
}

/* The best of a camera, including what it may yet see. */
static double best_of(const double *metrics, size_t count, const Unseen *unseen, size_t camera)
{
    double best = fmax(unseen->saturated[camera], unseen->black[camera]) * unseen->density[camera];
    for (size_t i = 0; i < count; i++)
        best = fmax(best, metrics[camera * count + i]);
    return best;
}

void worth_of_levels(const double *levels, size_t count, const double *metrics, size_t cameras, const Unseen *unseen,
                     double *worth)
{
    double greatest = 0.0;
    for (size_t camera = 0; camera < cameras; camera++)
        greatest = fmax(greatest, best_of(metrics, count, unseen, camera));
    for (size_t i = 0; i < count; i++)
        worth[i] = 0.0;
    for (size_t camera = 0; camera < cameras; camera++) {
        const double best = fmax(best_of(metrics, count, unseen, camera), fmax(LEAST_CAMERA * greatest, NOTHING));
        const double white = unseen->saturated[camera], black = unseen->black[camera], density = unseen->density[camera];
        const double down = probe_length(unseen, white), up = probe_length(unseen, black);
        for (size_t i = 0; i < count; i++) {
            const double below = probe_bonus((unseen->frontier - levels[i]) / down, white, density, unseen);
            const double above = probe_bonus((levels[i] - unseen->highest) / up, black, density, unseen);
            worth[i] += (metrics[camera * count + i] + (levels[i] > unseen->known_again ? below : 0.0) + above) / best;
        }
    }
    for (size_t i = 0; i < count; i++)
        worth[i] /= (double)cameras;
}
