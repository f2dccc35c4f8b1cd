/* Noise, and what motion blur and the front ends of consumers cost. */
#ifndef AUTOEXPOSE_NOISE_H
#define AUTOEXPOSE_NOISE_H

#include "picture/contrast.h"

/* Grey levels of contrast that feature detectors and matchers lose besides noise: FAST asks for 20 of them over 3 pixels.
 * Of 2 to 12, 6 and 8 did best for ORB and SIFT on two photographs and eight paintings in ten lights. */
#define FRONT_END_DN 6.0

/* Motion blur of this many pixels halves the energy of gradients: measured on the same pictures, shrunk by two. */
#define BLUR_PX 5.0

/* Variance of rounding to whole grey levels. */
#define QUANTISATION (1.0 / 12.0)

/* Variance of an image each pixel of which is the rounded mean of so many of the sensor's, whose noise has a variance,
 * in squared grey levels. */
static inline double variance_of(double noise, double pixels)
{
    const double averaged = (noise + QUANTISATION) / pixels;
    return pixels > 1.0 ? averaged + QUANTISATION : averaged;
}

/* Sums over the pixels of a cell: energy, noise expected and weight of the readable ones, and weight of all. */
typedef struct {
    double shown, expected, readable, weight;
} Cell;

/* The actual noise as a share of that expected, at most 1: what the flattest cells show. A sensor better than the one
 * configured would otherwise seem to see nothing in the dark. */
double share_of_noise(const Cell cells[ALL_CELLS]);

#endif
