/* How many pixels have each grey level, and how they changed since the last image. */
#ifndef AUTOEXPOSE_TONES_H
#define AUTOEXPOSE_TONES_H

#include "gradient.h"

/* counts[grey] of the pixels whose weight in `region` is not 0; with region == NULL of all. */
void grey_counts(const Image *image, const Image *region, double counts[GREY_LEVELS]);

/* How many pixels have at most this grey level; without gaps in rows, in less time than counting all grey levels. */
size_t count_at_most(const Image *image, int grey);

/* Every `stride`-th pixel across and down into `sampled`, row by row; 255 where it or a pixel around it is
 * saturated: saturated[grey] is 0 up to some grey level, and not 0 from there. Returns 0, or -1 if out of
 * memory. */
int sample_greys(const Image *image, size_t stride, const uint8_t saturated[GREY_LEVELS], uint8_t *sampled);

/* How log exposure changed between two samples: how many pixels count, how many of these are clipped in neither, and
 * the median, with pixels that are clipped in one sample as bounds; NaN if none shows a change. */
typedef struct {
    size_t counted, known;
    double median;
} Change;

/* From `before` to `now`, each `count` pixels; weights of 0 leave pixels out, NULL none. clipped[grey]: 0 below, 2 above,
 * 1 between. Returns 0, or -1 if out of memory. */
int light_change(const uint8_t *before, const uint8_t *now, const uint8_t *weights, size_t count,
                 const float log_exposure[GREY_LEVELS], const uint8_t clipped[GREY_LEVELS], Change *change);

#endif
