/* Gradient information of a grey image seen through look-up tables, as exact integer sums. */
#ifndef AUTOEXPOSE_GRADIENT_H
#define AUTOEXPOSE_GRADIENT_H

#include "image.h"

enum {
    GREY_LEVELS = 256,
    LANES = 8,               /* tables looked up at once */
    WIDEST = 524288          /* pixels: a row's sums of 255 * 255, one per 8 pixels, must fit 32 bits */
};

/* sums[lane] = sum over pixels of region * weights[m], m the rounded Sobel magnitude (at most 255, borders mirrored)
 * of the image seen through table `lane`: words[8 * grey + lane]. With words == NULL the image is used as
 * it is, and only sums[0] is valid. With region == NULL every pixel counts once; else region has the image's size.
 * The image is at least 2x2, and at most WIDEST wide. Returns 0, or -1 if out of memory. */
typedef int GradientSums(const Image *image, const Image *region, const uint8_t *words, const uint8_t *weights,
                         uint64_t sums[LANES]);

typedef struct {
    const char *name;
    GradientSums *sums;
} InstructionSet;

/* Those that this processor has, best first; the end has no name. All give the same sums. The first call must return
 * before another thread calls. */
const InstructionSet *instruction_sets(void);

#endif
