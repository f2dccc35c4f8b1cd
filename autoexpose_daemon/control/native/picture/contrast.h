/* Gradients of a grey image, collected by cell and bin of grey levels, as exact sums of integers. */
#ifndef AUTOEXPOSE_CONTRAST_H
#define AUTOEXPOSE_CONTRAST_H

#include "gradient.h"

enum { CELLS = 8, ALL_CELLS = CELLS * CELLS }; /* across or down, and in all */

/* Grey levels up to `black` are bin 0. From there bins are 1, then from 16, 48 and 112 above `black` on 2, 4 and 8 levels
 * wide, and those from `saturated` on are all bin `last`, the greatest. */
typedef struct {
    uint8_t black, saturated, last;
} GreyBins;

/* Bin of a grey level that is not saturated. */
int grey_bin(int grey, int black);

/* For each pixel off the border adds, at [cell][bin of brightest], its weight times
 * |(I(x+1) - I(x-1), I(y+1) - I(y-1))|^2 to `energy` and its weight to `count`; `brightest` is the greatest of the pixel
 * and its four neighbours. With region == NULL every pixel weighs 1; else region has the image's size. Both tables have
 * ALL_CELLS * (bins.last + 1) entries, which are set here. Returns 0, or -1 if out of memory. */
int contrast_sums(const Image *image, const Image *region, GreyBins bins, double *energy, double *count);

#endif
