/* The exposure time for each level: `BlurPhotonBalance` in C. */
#ifndef AUTOEXPOSE_SPLIT_H
#define AUTOEXPOSE_SPLIT_H

#include <stddef.h>

/* Times in log2 of microseconds, gains in stops. */
typedef struct {
    double shortest, longest, least_gain, greatest_gain;
} Bounds;

/* A pixel of middle brightness: factors of its variance (see SensorNoise), and how many of the sensor's it averages; and
 * how far it moves, in pixels of the frame in a microsecond, `scale` of which are one of the image. */
typedef struct {
    double shot, read, pixels, speed, scale;
} Middle;

/* times_us[i] is the best time for levels[i], stops; the longest of equals. */
void best_times(const double *levels, size_t count, const Bounds *bounds, const Middle *middle, double *times_us);

#endif
