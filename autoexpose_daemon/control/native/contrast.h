/* Gradients of a grey image, collected by cell and bin of grey levels, as exact sums of integers. */
#ifndef AUTOEXPOSE_CONTRAST_H
#define AUTOEXPOSE_CONTRAST_H

#include "gradient.h"

enum { CELLS = 8 }; /* across, and down */

/* For each pixel off the border adds, at [cell][bin_of[brightest]], its weight times
 * |(I(x+1) - I(x-1), I(y+1) - I(y-1))|^2 to `energy` and its weight to `count`; `brightest` is the greatest of the pixel
 * and its four neighbours. With region == NULL every pixel weighs 1; else region has the image's size. `bin_of` has
 * GREY_LEVELS entries below `bins`; both tables have CELLS * CELLS * bins entries, which are set here. Returns 0, or -1
 * if out of memory. */
int contrast_sums(const Image *image, const Image *region, const uint8_t *bin_of, size_t bins, double *energy,
                  double *count);

#endif
