/* The information of an image at other exposures, from the tables of contrast.h: `InformationPrediction` in C. */
#ifndef AUTOEXPOSE_INFORMATION_H
#define AUTOEXPOSE_INFORMATION_H

#include <stddef.h>

#include "contrast.h"

/* What follows from response and noise, by bin of grey levels, or by bin and exposure. */
typedef struct {
    size_t bins, exposures;
    const double *readable, *shot_now, *read_now; /* [bin] */
    const double *contrast, *shot, *read;         /* [bin][exposure] */
} Prediction;

/* The present image and those at other exposures: parameters of `InformationPrediction.curves`. */
typedef struct {
    double pixels, gain;
    const double *gains, *sharper;             /* [exposure] */
    const double *relative_light, *cell_weights; /* [cell], or NULL */
} Exposures;

/* Sums over the pixels of a cell: energy, noise expected and weight of the readable ones, and weight of all. */
typedef struct {
    double shown, expected, readable, weight;
} Cell;

/* The actual noise as a share of that expected: what the flattest cells show. */
double share_of_noise(const Cell cells[ALL_CELLS]);

/* Writes the curve, and a second one if there are cell weights, [exposure]. Returns 0, or -1 if out of memory. */
int predict_information(const Prediction *prediction, const Exposures *exposures, const double *energy,
                        const double *count, double *curve, double *steered);

#endif
