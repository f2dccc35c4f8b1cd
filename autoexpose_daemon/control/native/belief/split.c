#include "split.h"

#include <math.h>

#include "noise.h"

/* Exposure times that are compared, evenly spaced in stops; 20 us to 7.5 ms then lie 0.27 stop apart. */
enum { TIMES = 33 };

static double sharpness(double blur_px)
{
    return 1.0 / (1.0 + blur_px / BLUR_PX * (blur_px / BLUR_PX));
}

/* What a pixel of middle brightness tells at a time: `sharpness` over its variance and what front ends lose. */
static double worth_of(double time_us, double exposure, const Middle *middle)
{
    const double gain = exposure / time_us, blur = middle->speed * time_us / middle->scale / BLUR_PX;
    const double variance = variance_of(middle->shot * gain + middle->read * (gain * gain), middle->pixels);
    return 1.0 / (1.0 + blur * blur) / (variance + FRONT_END_DN * FRONT_END_DN);
}

void best_times(const double *levels, size_t count, const Bounds *bounds, const Middle *middle, double *times_us)
{
    for (size_t i = 0; i < count; i++) {
        const double longest = fmin(levels[i] - bounds->least_gain, bounds->longest);
        const double shortest = fmin(fmax(levels[i] - bounds->greatest_gain, bounds->shortest), longest);
        const double exposure = exp2(levels[i]);
        double best = 0.0;
        for (int step = 0; step < TIMES; step++) {
            const double time_us = exp2(longest + step / (TIMES - 1.0) * (shortest - longest));
            const double worth = worth_of(time_us, exposure, middle);
            if (!step || worth > best) {
                best = worth;
                times_us[i] = time_us;
            }
        }
    }
}

void split_levels(const double *levels, const double *times_us, size_t count, double speed, double now_us, double *gains,
                  double *sharp)
{
    const double now = sharpness(speed * now_us);
    for (size_t i = 0; i < count; i++) {
        gains[i] = exp2(levels[i]) / times_us[i];
        sharp[i] = sqrt(sharpness(speed * times_us[i]) / now);
    }
}
