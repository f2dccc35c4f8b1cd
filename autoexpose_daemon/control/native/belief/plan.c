#include "plan.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "picture/vectorised.h"

/* A camera's best counts as more than nothing. */
#define LEAST_BEST 1e-9

/* -------- what levels are worth now */

static double greatest_of(const double *values, size_t count)
{
    double greatest = values[0];
    for (size_t i = 1; i < count; i++)
        greatest = values[i] > greatest ? values[i] : greatest;
    return greatest;
}

/* What a camera expects of levels, over the hypotheses. */
static void expect(const Expected *expected, const double *information, size_t camera, double *mean)
{
    const double *probability = expected->probability + camera * HYPOTHESES;
    for (size_t i = 0; i < expected->levels; i++) {
        const double *of = information + camera * HYPOTHESES * expected->levels + i;
        mean[i] = 0.0;
        for (size_t hypothesis = 0; hypothesis < HYPOTHESES; hypothesis++)
            mean[i] += probability[hypothesis] * of[hypothesis * expected->levels];
        mean[i] *= expected->sharp[i];
    }
}

/* What each camera expects as a share of its best, shares[camera][level], by its vote; best[camera] is what counts as its
 * best, so that a lamp that one camera sees does not outvote the other. Writes their sum. */
static void share_out(const Expected *expected, const double *information, double *shares, double *best, double *worth)
{
    const size_t n = expected->levels;
    double greatest = 0.0;
    for (size_t camera = 0; camera < expected->cameras; camera++) {
        expect(expected, information, camera, shares + camera * n);
        best[camera] = greatest_of(shares + camera * n, n);
        greatest = fmax(greatest, best[camera]);
    }
    memset(worth, 0, n * sizeof *worth);
    for (size_t camera = 0; camera < expected->cameras; camera++) {
        best[camera] = fmax(best[camera], fmax(expected->least_camera * greatest, LEAST_BEST));
        for (size_t i = 0; i < n; i++) {
            shares[camera * n + i] *= expected->votes[camera] / best[camera];
            worth[i] += shares[camera * n + i];
        }
    }
}

/* What a level holds under a hypothesis if what is hidden holds as much as is hoped. */
static inline double hoped(const Expected *expected, const double *information, const double *nothing, size_t level)
{
    return expected->sharp[level] * (nothing[level] + expected->hope * (information[level] - nothing[level]));
}

/* What would be gained over staying at the best level, if a camera's hypothesis were known to be right. */
static double gain_of(const Expected *expected, const double *information, const double *nothing, double vote, double best,
                      const double *share, const double *worth, size_t now)
{
    double greatest = best, gained = 0.0;
    for (size_t i = 0; i < expected->levels; i++)
        greatest = fmax(greatest, hoped(expected, information, nothing, i));
    const double unit = vote / greatest;
    const double stay = worth[now] - share[now] + unit * hoped(expected, information, nothing, now);
    for (size_t i = 0; i < expected->levels; i++)
        gained = fmax(gained, worth[i] - share[i] + unit * hoped(expected, information, nothing, i) - stay);
    return gained;
}

int weigh_levels(const Expected *expected, double *worth, double *look)
{
    const size_t n = expected->levels;
    double *shares = malloc((expected->cameras * (n + 1) + n) * sizeof *shares);
    if (!shares)
        return -1;
    double *best = shares + expected->cameras * n, *favoured = best + expected->cameras;
    share_out(expected, expected->information, shares, best, worth);
    size_t now = 0;
    for (size_t i = 1; i < n; i++)
        now = worth[i] > worth[now] ? i : now;
    memset(look, 0, n * sizeof *look);
    for (size_t camera = 0; camera < expected->cameras; camera++)
        for (size_t hypothesis = 0; hypothesis < HYPOTHESES; hypothesis++) {
            const size_t place = camera * HYPOTHESES + hypothesis;
            const double gained = gain_of(expected, expected->information + place * n,
                                          expected->information + camera * HYPOTHESES * n, expected->votes[camera],
                                          best[camera], shares + camera * n, worth, now);
            for (size_t i = 0; i < n; i++)
                look[i] += expected->served * expected->probability[place] * gained * expected->revealed[place * n + i];
        }
    if (expected->favoured) {
        share_out(expected, expected->favoured, shares, best, favoured);
        const double affordable = (1.0 - expected->steering_share) * worth[now];
        for (size_t i = 0; i < n; i++)
            worth[i] = worth[i] > affordable ? favoured[i] : 0.0;
    }
    free(shares);
    return 0;
}

/* -------- the plan */

/* What levels are worth when the light will have risen as on each of the paths, in the mean. */
static void read_off(const Plan *plan, const double *of_levels, size_t frame, size_t count, double *found)
{
    const double last = (double)(plan->levels - 1);
    memset(found, 0, count * sizeof *found);
    for (size_t path = 0; path < plan->paths; path++) {
        const double risen = plan->light[path * (plan->frames + 1) + frame] / plan->step + (double)plan->beyond;
        for (size_t i = 0; i < count; i++) {
            const double place = fmin(fmax(risen + (double)i, 0.0), last), below = fmin(floor(place), last - 1.0);
            const double *at = of_levels + (size_t)below;
            found[i] += plan->chances[path] * (at[0] + (place - below) * (at[1] - at[0]));
        }
    }
}

static double mean_light(const Plan *plan, size_t frame)
{
    double light = 0.0;
    for (size_t path = 0; path < plan->paths; path++)
        light += plan->chances[path] * plan->light[path * (plan->frames + 1) + frame];
    return light;
}

/* A frame's worth, given what the change of brightness leaves of it: a lost frame costs more than it would be worth. */
static inline double worth_of_pair(double left, double lost_below, double lost_cost)
{
    return left - lost_cost * (left < lost_below ? 1.0 - left / lost_below : 0.0);
}

/* What each level of a frame promises, if the best follows in the next one, whose levels promise so much. left[i]: what is
 * left of the next frame's worth if its level is by i - (count - 1) steps higher. */
VECTORISED static void look_ahead(const Plan *plan, const double *worth, const double *later, const double *left,
                                  size_t count, double *restrict promised)
{
    const double lost_below = plan->lost_below, lost_cost = plan->lost_cost;
    for (size_t i = 0; i < count; i++)
        promised[i] = -INFINITY;
    for (size_t next = 0; next < count; next++) {
        const double *reversed = left + (count - 1 - next);
        for (size_t i = 0; i < count; i++) {
            const double value = worth_of_pair(worth[next] * reversed[i], lost_below, lost_cost) + later[next];
            promised[i] = value > promised[i] ? value : promised[i];
        }
    }
}

int plan_frames(const Plan *plan, double *values, double *looks)
{
    const size_t n = plan->levels - 2 * plan->beyond;
    double *worth = malloc(5 * n * sizeof *worth);
    if (!worth)
        return -1;
    double *left = worth + n, *later = worth + 3 * n, *promised = worth + 4 * n;
    for (size_t i = 0; i < n; i++)
        later[i] = 0.0;
    for (size_t frame = plan->frames; frame > 1; frame--) {
        const double risen = mean_light(plan, frame) - mean_light(plan, frame - 1);
        read_off(plan, plan->worth, frame, n, worth);
        for (size_t i = 0; i < 2 * n - 1; i++) /* the next level is lower by i - (n - 1) steps */
            left[i] = exp(-plan->brightness_loss * fabs(risen - plan->step * ((double)i - (double)(n - 1))));
        look_ahead(plan, worth, later, left, n, promised);
        memcpy(later, promised, n * sizeof *later);
    }
    const double risen = mean_light(plan, 1) - mean_light(plan, 0);
    read_off(plan, plan->worth, 1, n, worth);
    read_off(plan, plan->look, 1, n, looks);
    for (size_t i = 0; i < n; i++) {
        const double change = plan->lowest + plan->step * (double)i + risen - plan->before;
        const double kept = worth[i] * exp(-plan->brightness_loss * fabs(change));
        values[i] = worth_of_pair(kept, plan->lost_below, plan->lost_cost) + later[i] + looks[i];
    }
    free(worth);
    return 0;
}
