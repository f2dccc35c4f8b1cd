#include "unseen.h"

#include <math.h>

#include "contrast.h"

enum { ALL = CELLS * CELLS };

/* As in unseen.py. */
#define DEPTH_STEP 0.25
#define NEXT_TO_WHITE 0.5
#define BORROWED 0.3
#define FAR_RATE 0.2
#define REACH 2.0
#define LEAST_SHARE 0.02

/* Sums over the pixels of all cells in the bins from `first` on that are readable: how many they are, and their mean
   energy in squared stops. */
typedef struct {
    double count, contrast;
} Shown;

static Shown shown_in(const BinLevels *levels, const double *count, size_t stride, const double *signal, size_t first)
{
    double pixels = 0.0, energy = 0.0, squared_slopes = 0.0;
    for (size_t cell = 0; cell < ALL; cell++, count += levels->bins, signal += stride)
        for (size_t bin = first; bin < levels->bins; bin++)
            if (levels->readable[bin] > 0.0) {
                pixels += count[bin];
                energy += signal[bin];
                squared_slopes += count[bin] * levels->slopes2[bin];
            }
    const Shown shown = {pixels, fmax(energy, 0.0) / fmax(squared_slopes, 1e-9)};
    return shown;
}

static double total_of(const BinLevels *levels, const double *count)
{
    double total = 0.0;
    for (size_t i = 0; i < ALL * levels->bins; i++)
        total += count[i];
    return total;
}

static void expect_in_shade(const BinLevels *levels, const double *count, size_t stride, double *signal)
{
    const Shown bright = shown_in(levels, count, stride, signal, 1 + SHADE);
    if (bright.count <= LEAST_SHARE * total_of(levels, count))
        return;
    for (size_t cell = 0; cell < ALL; cell++, count += levels->bins, signal += stride) {
        double lacking[SHADE], energy = 0.0;
        for (size_t grey = 0; grey < SHADE; grey++) {
            const double slope2 = levels->slopes2[1 + grey];
            lacking[grey] = count[1 + grey] * bright.contrast - signal[1 + grey] / slope2;
            energy += lacking[grey] * slope2;
        }
        if (energy > 0.0)
            for (size_t grey = 0; grey < SHADE; grey++)
                signal[levels->bins + grey] = lacking[grey];
    }
}

/* The share of saturated pixels that are still saturated so many stops below. */
static double share_left(double rate, double stops)
{
    if (rate >= FAR_RATE)
        return exp(-rate * stops);
    return exp(-(FAR_RATE * stops + (rate - FAR_RATE) * REACH * (1.0 - exp(-stops / REACH))));
}

static void expect_above(const BinLevels *levels, const double *count, size_t depths, size_t stride, double *signal)
{
    size_t next_to_white = 0;
    while (levels->readable[next_to_white] == 0.0 || levels->stops[next_to_white] < -NEXT_TO_WHITE)
        if (++next_to_white == levels->bins)
            return;
    const Shown shown = shown_in(levels, count, stride, signal, next_to_white);
    const size_t last = levels->bins - 1;
    double white = 0.0;
    for (size_t cell = 0; cell < ALL; cell++)
        white += count[cell * levels->bins + last];
    if (white == 0.0)
        return;
    const double borrowed = BORROWED * total_of(levels, count) / ALL, all = shown.count / NEXT_TO_WHITE / white;
    for (size_t cell = 0; cell < ALL; cell++, count += levels->bins, signal += stride) {
        if (count[last] == 0.0)
            continue;
        double near = 0.0, before = 1.0;
        for (size_t bin = next_to_white; bin < levels->bins; bin++)
            if (levels->readable[bin] > 0.0)
                near += count[bin] / NEXT_TO_WHITE;
        const double rate = (near + borrowed * all) / (count[last] + borrowed);
        for (size_t depth = 0; depth < depths; depth++) {
            const double left = share_left(rate, (double)(depth + 1) * DEPTH_STEP);
            signal[levels->bins + SHADE + depth] = count[last] * (before - left) * shown.contrast;
            before = left;
        }
    }
}

void expect_unseen(const BinLevels *levels, const double *count, size_t depths, size_t stride, double *signal)
{
    expect_in_shade(levels, count, stride, signal);
    expect_above(levels, count, depths, stride, signal);
}
