#include "outlook.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "hidden.h"
#include "noise.h"
#include "picture/vectorised.h"

/* Cells whose sums fit into the registers of a processor. */
enum { AT_ONCE = 16 };

/* The scene as frames would show it, its cells in the order of the light that they get. */
typedef struct {
    size_t order[ALL_CELLS];
    double light[ALL_CELLS], weights[ALL_CELLS], favoured[ALL_CELLS]; /* weights sum to 1 */
    double unit;                                                      /* 1 / pixels of a cell */
    Bins looked;
    double (*known)[ALL_CELLS];    /* [bin][cell], contrast that was seen */
    Guess guesses[GUESSES][SIDES]; /* about what was not */
    double *worth, *at;            /* [bin], and for each sample of it */
} View;

static void sort_by_light(const double light[ALL_CELLS], View *view)
{
    for (size_t cell = 0; cell < ALL_CELLS; cell++) {
        size_t place = cell;
        for (; place && light[view->order[place - 1]] > light[cell]; place--)
            view->order[place] = view->order[place - 1];
        view->order[place] = cell;
    }
}

static void sort_cells(const double values[ALL_CELLS], const View *view, double sorted[ALL_CELLS])
{
    for (size_t cell = 0; cell < ALL_CELLS; cell++)
        sorted[cell] = values[view->order[cell]];
}

/* How much each cell counts in a mean; favours may be NULL. */
static void weigh_cells(const Outlooks *frames, const View *view, const double *favours, double weights[ALL_CELLS])
{
    for (size_t cell = 0; cell < ALL_CELLS; cell++) {
        const size_t place = view->order[cell];
        weights[cell] = frames->by_cell[place] > 0.0 ? (favours ? favours[place] : 1.0) : 0.0;
    }
    const double sum = fmax(sum_of_cells(weights), LEAST_PIXELS);
    for (size_t cell = 0; cell < ALL_CELLS; cell++)
        weights[cell] /= sum;
}

static double unit_of(const double by_cell[ALL_CELLS])
{
    double cells = 0.0;
    for (size_t cell = 0; cell < ALL_CELLS; cell++)
        cells += by_cell[cell] != 0.0;
    return cells / fmax(sum_of_cells(by_cell), 1.0);
}

VECTORISED static void recall(const Rules *rules, const Scene *scene, View *view)
{
    view->looked = bins_looked_at(scene);
    for (size_t bin = view->looked.first; bin < view->looked.end; bin++) {
        double known[ALL_CELLS];
        find_contrast(rules, scene, bin, known);
        sort_cells(known, view, view->known[bin]);
    }
}

/* `tables` and `before` are room for those of the guesses. */
static void guess_all(const Rules *rules, const Scene *scene, Bins wanted, View *view, double (*tables)[ALL_CELLS],
                      double *before)
{
    double hidden[SIDES][ALL_CELLS], tail[SIDES][ALL_CELLS], richness[SIDES][ALL_CELLS];
    Scene sorted = *scene;
    sorted.hidden = hidden;
    sorted.tail = tail;
    sorted.richness = richness;
    for (size_t side = 0; side < SIDES; side++) {
        sort_cells(scene->hidden[side], view, hidden[side]);
        sort_cells(scene->tail[side], view, tail[side]);
        sort_cells(scene->richness[side], view, richness[side]);
    }
    for (size_t guess = 0; guess < GUESSES; guess++, tables += scene->bins) /* the sides have no bins in common */
        for (size_t side = 0; side < SIDES; side++, before += scene->bins + 1) {
            view->guesses[guess][side] = (Guess){.wanted = wanted, .before = before, .contrast = tables};
            guess_hidden(rules, &sorted, side, guess, &view->guesses[guess][side]);
        }
}

/* What squared contrast in bins is worth in a frame, where the lens lets so much light through: squared slope over the
 * variance of noise and front end. Consumers divide the light of the lens out, which scales contrast and noise alike. */
VECTORISED static void find_worth(const Rules *rules, const Optics *optics, const Outlooks *frames, size_t frame,
                                  double light, Bins bins, const View *view)
{
    if (bins.first == bins.end)
        return;
    double *restrict at = view->at, *restrict worth = view->worth;
    const ptrdiff_t apart = lrint(rules->bin / optics->step) / SAMPLES, places = (ptrdiff_t)optics->places;
    const double gain = frames->gains[frame], share = frames->noise_share, front_end = light * FRONT_END_DN;
    const double shot = share / frames->averaged * gain, read = shot * gain;
    const double lost = share * variance_of(0.0, frames->averaged) + front_end * front_end;
    const double exposure = edge_of(rules, bins.first) + rules->bin / (2 * SAMPLES) + frames->levels[frame];
    const ptrdiff_t begin = lrint(exposure / optics->step) - optics->first;
    const ptrdiff_t count = SAMPLES * (ptrdiff_t)(bins.end - bins.first);
    const ptrdiff_t low = begin < 0 ? (apart - 1 - begin) / apart : 0, high = (places - begin + apart - 1) / apart;
    memset(at, 0, (size_t)count * sizeof *at);
    for (ptrdiff_t i = low; i < (high < count ? high : count); i++) {
        const ptrdiff_t place = begin + i * apart;
        at[i] = optics->slope2_at[place] / (optics->shot_at[place] * shot + optics->read_at[place] * read + lost);
    }
    for (size_t bin = bins.first; bin < bins.end; bin++, at += SAMPLES)
        worth[bin] = (at[0] + at[1] + at[2] + at[3]) / SAMPLES;
}

/* Adds what the contrast of some cells is worth. */
VECTORISED static void add_worth(double (*contrast)[ALL_CELLS], const double *worth, Bins bins, size_t first, size_t end,
                                 double *restrict found)
{
    size_t cell = first;
    for (; cell + AT_ONCE <= end; cell += AT_ONCE) {
        Lanes *sums = (Lanes *)(found + cell), one = sums[0], two = sums[1], three = sums[2], four = sums[3];
        for (size_t bin = bins.first; bin < bins.end; bin++) {
            const Lanes *lanes = (const Lanes *)(contrast[bin] + cell);
            one += worth[bin] * lanes[0];
            two += worth[bin] * lanes[1];
            three += worth[bin] * lanes[2];
            four += worth[bin] * lanes[3];
        }
        sums[0] = one;
        sums[1] = two;
        sums[2] = three;
        sums[3] = four;
    }
    for (size_t bin = bins.first; bin < bins.end; bin++)
        for (size_t left = cell; left < end; left++)
            found[left] += worth[bin] * contrast[bin][left];
}

/* Means over the cells of the root of what their mean pixel holds. */
VECTORISED static void find_information(const double found[ALL_CELLS], const View *view, double *information,
                                        double *favoured)
{
    double roots[ALL_CELLS];
    for (size_t cell = 0; cell < ALL_CELLS; cell++)
        roots[cell] = sqrt(found[cell] * view->unit);
    *information = weighted_sum(roots, view->weights);
    if (favoured)
        *favoured = weighted_sum(roots, view->favoured);
}

/* How much of what is hidden lies in bins, pixels. */
static double hidden_in(const Guess sides[SIDES], Bins bins)
{
    double within = 0.0;
    for (const Guess *guess = sides; guess < sides + SIDES; guess++) {
        const Bins shared = common(guess->bins, bins);
        within += shared.first < shared.end ? guess->before[shared.end] - guess->before[shared.first] : 0.0;
    }
    return within;
}

/* The bins that are seen at levels. */
static Bins bins_reached(const Rules *rules, const Scene *scene, const Optics *optics, double lowest, double highest)
{
    const double first = (double)optics->first * optics->step, end = first + (double)optics->places * optics->step;
    return bins_between(rules, scene->bins, first - highest, end - lowest);
}

static void look_at(const Rules *rules, const Scene *scene, const Optics *optics, const Outlooks *frames, size_t frame,
                    const View *view, double *information, double *favoured, double *revealed)
{
    const double level = frames->levels[frame];
    const Bins reached = bins_reached(rules, scene, optics, level, level);
    const double black = optics->low[1] - level, saturated = optics->low[optics->bins - 1] - level, half = rules->bin / 2;
    /* Wholly: the rest of a bin would be looked for again and again. */
    const Bins shown = bins_with_middles(rules, scene->bins, black + half, saturated - half);
    const double hidden = fmax(sum_of_cells(scene->hidden[DARK]) + sum_of_cells(scene->hidden[BRIGHT]), LEAST_PIXELS);
    double found[HYPOTHESES][ALL_CELLS] = {{0.0}};
    for (size_t first = 0, end; first < ALL_CELLS; first = end) {
        for (end = first; end < ALL_CELLS && view->light[end] == view->light[first];)
            end++;
        find_worth(rules, optics, frames, frame, view->light[first], reached, view);
        add_worth(view->known, view->worth, common(reached, view->looked), first, end, found[0]);
        for (size_t guess = 0; guess < GUESSES; guess++) {
            memcpy(found[1 + guess] + first, found[0] + first, (end - first) * sizeof **found);
            for (size_t side = 0; side < SIDES; side++)
                add_worth(view->guesses[guess][side].contrast, view->worth,
                          common(reached, view->guesses[guess][side].bins), first, end, found[1 + guess]);
        }
    }
    for (size_t hypothesis = 0; hypothesis < HYPOTHESES; hypothesis++) {
        const size_t place = hypothesis * frames->count + frame;
        find_information(found[hypothesis], view, information + place, favoured ? favoured + place : NULL);
        revealed[place] = hidden_in(view->guesses[hypothesis ? hypothesis - 1 : 0], shown) / hidden;
    }
}

int look_out(const Rules *rules, const Scene *scene, const Optics *optics, const Outlooks *frames, double *information,
             double *favoured, double *revealed, double *continues)
{
    const size_t bins = scene->bins;
    double(*tables)[ALL_CELLS] = malloc((1 + GUESSES) * bins * sizeof *tables +
                                        ((GUESSES * SIDES + 1 + SAMPLES) * (bins + 1)) * sizeof **tables);
    if (!tables)
        return -1;
    double *numbers = (double *)(tables + (1 + GUESSES) * bins);
    View view = {.known = tables, .worth = numbers, .at = numbers + bins, .unit = unit_of(frames->by_cell)};
    double lowest = INFINITY, highest = -INFINITY;
    for (size_t frame = 0; frame < frames->count; frame++) {
        lowest = fmin(lowest, frames->levels[frame]);
        highest = fmax(highest, frames->levels[frame]);
    }
    const Bins wanted = bins_reached(rules, scene, optics, lowest, highest);
    sort_by_light(frames->light, &view);
    sort_cells(frames->light, &view, view.light);
    weigh_cells(frames, &view, NULL, view.weights);
    weigh_cells(frames, &view, frames->favours, view.favoured);
    recall(rules, scene, &view);
    guess_all(rules, scene, wanted, &view, tables + bins, view.at + SAMPLES * bins);
    for (size_t frame = 0; frame < frames->count; frame++)
        look_at(rules, scene, optics, frames, frame, &view, information, favoured, revealed);
    *continues = share_that_continues(rules, scene);
    free(tables);
    return 0;
}
