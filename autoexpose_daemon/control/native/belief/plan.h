/* What levels are worth to cameras together, and the exposures that make successive frames worth most to each other. */
#ifndef AUTOEXPOSE_PLAN_H
#define AUTOEXPOSE_PLAN_H

#include <stddef.h>

#include "belief.h"

/* What cameras expect of levels: `Outlook`. */
typedef struct {
    size_t cameras, levels;
    const double *information, *favoured, *revealed; /* [camera][hypothesis][level]; favoured may be NULL */
    const double *probability;                       /* [camera][hypothesis] */
    const double *votes;                             /* [camera] */
    const double *sharp;                             /* [level], what motion blur leaves of information */
    double hope, least_camera, steering_share, served; /* as in policy.py */
} Expected;

/* What each level is worth now, and what it is worth to see what it would reveal. Returns 0, or -1 if out of memory. */
int weigh_levels(const Expected *expected, double *worth, double *look);

/* Levels, `step` apart, and what they are worth in the present light. The first and the last `beyond` of them are needed
 * only to read off what others are worth in other light. */
typedef struct {
    size_t levels, beyond, frames, paths;
    double step, lowest, before;
    double brightness_loss, lost_below, lost_cost; /* as in plan.py */
    const double *worth, *look; /* [level] */
    const double *light;        /* [path][frames + 1], stops by which it will have risen */
    const double *chances;      /* [path] */
} Plan;

/* What each level but those beyond promises for the first frame, if the best follows, and what of that is for what it
 * reveals. Returns 0, or -1 if out of memory. */
int plan_frames(const Plan *plan, double *values, double *looks);

#endif
