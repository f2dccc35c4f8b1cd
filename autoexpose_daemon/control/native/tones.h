/* How many pixels have each grey level, and how they changed since the last image. */
#ifndef AUTOEXPOSE_TONES_H
#define AUTOEXPOSE_TONES_H

#include "gradient.h"

/* counts[grey] of the pixels whose weight in `region` is not 0; with region == NULL of all. */
void grey_counts(const Image *image, const Image *region, double counts[GREY_LEVELS]);

/* Every `stride`-th pixel across and down into `sampled`, row by row; 255 where it or a pixel around it is
 * saturated: saturated[grey] is 0 up to some grey level, and not 0 from there. */
void sample_greys(const Image *image, size_t stride, const uint8_t saturated[GREY_LEVELS], uint8_t *sampled);

/* Changes of log exposure, as `light_changes` sorts them. */
typedef struct {
    size_t counted, known, at_least, all;
} Changes;

/* From `before` to `now`, each `count` pixels; weights of 0 leave pixels out, NULL none. clipped[grey] is 2 above, 0
 * below, 1 between. Writes to `values`, which has room for 2 * count: known changes (of pixels clipped in neither image),
 * then, if there are others, the lower and upper bounds from pixels clipped in one, and the known ones again. */
Changes light_changes(const uint8_t *before, const uint8_t *now, const uint8_t *weights, size_t count,
                      const float log_exposure[GREY_LEVELS], const uint8_t clipped[GREY_LEVELS], float *values);

#endif
