/* How far a picture has moved, by the log of its light. */
#ifndef AUTOEXPOSE_SHIFT_H
#define AUTOEXPOSE_SHIFT_H

#include "image.h"

/* A block's light: 1/128 stop above the darkest that counts; the brightest is at most BRIGHTEST. */
enum { BRIGHTEST = 2047 };

/* Blocks of a picture either way, and pixels of a block either way. */
enum { LEAST_BLOCKS = 16, MOST_BLOCKS = 90, LARGEST_BLOCK = 16 };

/* The light of blocks of `side` x `side` pixels, at most LARGEST_BLOCK, by the sum of their grey levels, into `light`,
 * (height / side, width / side). Returns -1 without memory. */
int light_of_blocks(const Image *image, size_t side, const int16_t *light_of_sum, int16_t *light);

/* The median distance over the picture, in blocks, between where things are in two pictures of blocks, (height, width),
 * whose light ends at `brightest`. Negative if hardly anything is neither black nor white in both, NaN without memory. */
double median_shift(const int16_t *before, const int16_t *now, size_t height, size_t width, int16_t brightest);

#endif
