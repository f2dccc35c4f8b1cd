/* The pattern in changes of light: the arithmetic of `Forecast`, which says what is meant. */
#ifndef AUTOEXPOSE_FORECAST_H
#define AUTOEXPOSE_FORECAST_H

#include <stddef.h>

/* What a period must explain: so many frames, of a variance of at least this, of which it may leave a share. */
typedef struct {
    size_t least_frames;
    double least_variance, residue;
} Pattern;

/* The shortest number of frames after which the newest changes, oldest first, repeat themselves; 0: none. */
size_t find_period(const double *changes, size_t count, const Pattern *pattern);

#endif
