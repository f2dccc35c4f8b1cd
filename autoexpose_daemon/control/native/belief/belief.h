/* What a camera knows of the light that its scene sends: the arithmetic of `SceneBelief`, which says what is meant. */
#ifndef AUTOEXPOSE_BELIEF_H
#define AUTOEXPOSE_BELIEF_H

#include <stddef.h>

#include "picture/contrast.h"

/* Distances at which mass may be detached; log exposures for which a bin stands. */
enum { SIDES = 2, DISTANCES = 2, GUESSES = 1 + DISTANCES, HYPOTHESES = 1 + GUESSES, SAMPLES = 4 };

/* `RULES` of scene_belief.py. Two lengths are of the dark side and of the bright one. */
typedef struct {
    double lowest, bin, renewed, unsure, least_look, longest_tail, detached[DISTANCES], detached_tail, half_detached_tail,
        neighbours[SIDES];
} Rules;

/* The arrays of a `SceneBelief`; sides: what is darker than shown, and what is brighter. */
typedef struct {
    size_t bins;
    double usual_richness; /* of a pixel */
    double (*mass)[ALL_CELLS], (*energy)[ALL_CELLS], (*precision)[ALL_CELLS]; /* [bin][cell] */
    double *seen;                                                             /* [bin] */
    double *bounds;                                                           /* [side], log radiance */
    double (*hidden)[ALL_CELLS], (*tail)[ALL_CELLS], (*richness)[ALL_CELLS];  /* [side][cell] */
} Scene;

/* Of a camera, by bin of grey levels; and `places` log exposures, `step` apart, from `first` steps
 * on, at the ends of which nothing is visible. */
typedef struct {
    size_t bins, places;
    ptrdiff_t first;
    double step;
    const double *readable, *low, *high, *slope2, *inverse_slope2, *shot, *read; /* [bin] */
    const double *slope2_at, *shot_at, *read_at;                                 /* [place] */
} Optics;

/* Its gradients, [cell][bin of grey levels]; its exposure level, beyond the drift of the belief; and its linear gain. */
typedef struct {
    const double *energy, *count;
    double level, gain, averaged;
} Frame;

/* What a frame tells besides what becomes of the scene: the noise as a share of that expected, and of the contrast guessed
 * in what had not been looked at: all of it, what the frame should have shown, and what it did show. The last two are 0
 * if it shows hardly anything new. */
typedef struct {
    double noise_share, guessed, expected, found;
} Told;

/* What was seen grows old: `kept` is left of it, the camera has moved by a share of a cell, and the light has risen by so
 * many bins. */
void pass_time(const Scene *scene, double kept, double moved, ptrdiff_t risen);

/* Takes in a frame; by_cell[cell] is written. Returns 0, or -1 if out of memory. */
int see_frame(const Rules *rules, Scene *scene, const Optics *optics, const Frame *frame, double *by_cell,
              Told *told);

#endif
