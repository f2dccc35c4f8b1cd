/* What the clipped parts of a picture may show at other exposures: unseen.py in C. */
#ifndef AUTOEXPOSE_UNSEEN_H
#define AUTOEXPOSE_UNSEEN_H

#include <stddef.h>

enum { SHADE = 2 };

/* `BinLevels`. */
typedef struct {
    size_t bins;
    const double *readable, *slopes2, *stops; /* [bin] */
} BinLevels;

/* Adds to rows of `stride` numbers, one for each cell, from the last bin on: SHADE grey levels, then `depths`. Until
   then they are the energy of gradients without that of noise, by bin. */
void expect_unseen(const BinLevels *levels, const double *count, size_t depths, size_t stride, double *signal);

#endif
