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

/* What it means to take levels at these times: linear gains, and how sharp images are, by the root of `sharpness`, as a
 * multiple of that at `now_us`. speed: pixels of the image in a microsecond. */
void split_levels(const double *levels, const double *times_us, size_t count, double speed, double now_us, double *gains,
                  double *sharp);

#endif
