/* What frames at other exposures would hold of a scene. */
#ifndef AUTOEXPOSE_OUTLOOK_H
#define AUTOEXPOSE_OUTLOOK_H

#include "belief.h"

/* Frames that may be taken: levels beyond the drift, linear gains; and how they are judged, cells by their weights. */
typedef struct {
    size_t count;
    const double *levels, *gains;            /* [level] */
    const double *by_cell, *light, *favours; /* [cell]; favours may be NULL */
    double averaged, noise_share;
} Outlooks;

/* Under each hypothesis (there is nothing, it continues, it is detached so far), at each level: information,
 * [hypothesis][level], and again as favoured, or NULL; the share of what is hidden that would be shown; and the one that
 * is expected to continue. Returns 0, or -1 if out of memory. */
int look_out(const Rules *rules, const Scene *scene, const Optics *optics, const Outlooks *frames, double *information,
             double *favoured, double *revealed, double *continues);

#endif
