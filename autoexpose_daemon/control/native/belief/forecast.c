#include "forecast.h"

static int repeats(const double *changes, size_t count, size_t period, const Pattern *pattern)
{
    double sum = 0.0, squares = 0.0, differences = 0.0;
    for (size_t i = 0; i < count; i++)
        sum += changes[i];
    for (size_t i = 0; i < count; i++)
        squares += (changes[i] - sum / (double)count) * (changes[i] - sum / (double)count);
    for (size_t i = period; i < count; i++)
        differences += (changes[i] - changes[i - period]) * (changes[i] - changes[i - period]);
    const double variance = squares / (double)count;
    return variance >= pattern->least_variance &&
           differences / (double)(count - period) < 2.0 * pattern->residue * variance;
}

size_t find_period(const double *changes, size_t count, const Pattern *pattern)
{
    for (size_t period = 2; period <= count / 2; period++) {
        const size_t explained = period > pattern->least_frames ? period : pattern->least_frames;
        const size_t seen = explained + period < count ? explained + period : count;
        if (seen >= pattern->least_frames + 2 && repeats(changes + count - seen, seen, period, pattern))
            return period;
    }
    return 0;
}
