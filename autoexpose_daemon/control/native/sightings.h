/* What sightings of a scene predict at other exposures: `MetricMemory` in C. */
#ifndef AUTOEXPOSE_SIGHTINGS_H
#define AUTOEXPOSE_SIGHTINGS_H

#include <stddef.h>

/* `deltas` rise, and are those of all curves. */
typedef struct {
    size_t count, cameras, deltas;
    const double *levels, *ages; /* [sighting] */
    const double *blind;         /* [sighting][camera] */
    const double *curves;        /* [sighting][camera][delta] */
    const double *delta;
} Sightings;

/* values and distances: [sighting][camera][level], at `count` levels; doubting: as `DOUBT` says. */
void predict_metrics(const Sightings *seen, const double *levels, size_t count, int doubting, double *values,
                     double *distances);

/* Of each camera: clipped shares, and metric of a pixel of good exposure. */
typedef struct {
    const double *saturated, *black, *density;
    double frontier, known_again, highest; /* levels: see search.py */
    double shortest, power, worth;         /* of probes, as `Probes` */
    int moving;
} Unseen;

/* worth[level], from metrics[camera][level]: `worth_of_levels` in C. */
void worth_of_levels(const double *levels, size_t count, const double *metrics, size_t cameras, const Unseen *unseen,
                     double *worth);

#endif
