#include "hidden.h"

#include <math.h>
#include <stdlib.h>

#include "picture/vectorised.h"

/* What is hidden is somewhere, even if all has been looked at. */
#define SOMEWHERE 1e-9

Bins bins_between(const Rules *rules, size_t bins, double low, double high)
{
    const double first = floor((low - rules->lowest) / rules->bin), end = ceil((high - rules->lowest) / rules->bin);
    const double from = fmin(fmax(first, 0.0), (double)bins);
    return (Bins){(size_t)from, (size_t)fmin(fmax(end, from), (double)bins)};
}

Bins bins_with_middles(const Rules *rules, size_t bins, double low, double high)
{
    Bins within = bins_between(rules, bins, low, high);
    while (within.first < within.end && edge_of(rules, within.first) + rules->bin / 2 < low)
        within.first++;
    while (within.first < within.end && edge_of(rules, within.end - 1) + rules->bin / 2 >= high)
        within.end--;
    return within;
}

Bins bins_beyond(const Rules *rules, const Scene *scene, size_t side)
{
    const double bound = scene->bounds[side];
    return side == DARK ? bins_with_middles(rules, scene->bins, -INFINITY, bound)
                        : bins_with_middles(rules, scene->bins, bound, INFINITY);
}

Bins bins_looked_at(const Scene *scene)
{
    Bins bins = {0, scene->bins};
    while (bins.first < bins.end && scene->seen[bins.first] == 0.0)
        bins.first++;
    while (bins.first < bins.end && scene->seen[bins.end - 1] == 0.0)
        bins.end--;
    return bins;
}

Bins common(Bins one, Bins other)
{
    const size_t first = one.first > other.first ? one.first : other.first;
    const size_t end = one.end < other.end ? one.end : other.end;
    return (Bins){first, end > first ? end : first};
}

double share_that_continues(const Rules *rules, const Scene *scene)
{
    double hidden = 0.0, continues = 0.0;
    for (size_t side = 0; side < SIDES; side++)
        for (size_t cell = 0; cell < ALL_CELLS; cell++) {
            hidden += scene->hidden[side][cell];
            continues += scene->hidden[side][cell] / (1.0 + scene->tail[side][cell] / rules->half_detached_tail);
        }
    return hidden == 0.0 ? 1.0 : continues / hidden;
}

double chance_of(size_t number, double continues)
{
    return number ? (1.0 - continues) / DISTANCES : continues;
}

/* likely[bin] falls off over the tails, from so many stops beyond the bound on, and is less where there was a look. Of
 * the first `cells` only, if those after them are alike. */
VECTORISED static void fall_off(const Rules *rules, const Scene *scene, size_t side, double away, const double *tails,
                                size_t cells, Bins within, double (*likely)[ALL_CELLS], double *restrict sums)
{
    double ratio[ALL_CELLS], falling[ALL_CELLS];
    for (size_t cell = 0; cell < cells; cell++) {
        ratio[cell] = exp(-rules->bin / tails[cell]);
        falling[cell] = sums[cell] = 0.0;
    }
    int begun = 0;
    for (size_t i = 0; i < within.end - within.first; i++) {
        const size_t bin = side == DARK ? within.end - 1 - i : within.first + i;
        const double beyond = fabs(edge_of(rules, bin) + rules->bin / 2 - scene->bounds[side]);
        const double unseen = 1.0 - scene->seen[bin], anywhere = SOMEWHERE * exp(-beyond / rules->longest_tail);
        double *restrict here = likely[bin];
        for (size_t cell = 0; !begun && beyond >= away && cell < cells; cell++)
            falling[cell] = exp((away - beyond) / tails[cell]);
        begun = beyond >= away;
        for (size_t cell = 0; cell < cells; cell++) {
            here[cell] = falling[cell] * unseen + anywhere;
            sums[cell] += here[cell];
            falling[cell] *= ratio[cell];
        }
    }
}

VECTORISED void guess_hidden(const Rules *rules, const Scene *scene, size_t side, size_t number, Guess *guess)
{
    const Bins beyond = bins_beyond(rules, scene, side);
    guess->bins = common(beyond, guess->wanted);
    if (sum_of_cells(scene->hidden[side]) == 0.0)
        guess->bins.end = guess->bins.first;
    guess->before[guess->bins.first] = 0.0;
    if (guess->bins.first == guess->bins.end)
        return;
    double tails[ALL_CELLS], sums[ALL_CELLS], pixels[ALL_CELLS], contrast[ALL_CELLS];
    for (size_t cell = 0; cell < ALL_CELLS; cell++)
        tails[cell] = number ? rules->detached_tail : lesser(scene->tail[side][cell], rules->longest_tail);
    const double away = number ? rules->detached[number - 1] : 0.0;
    const size_t cells = number ? 1 : ALL_CELLS; /* whose tails differ */
    fall_off(rules, scene, side, away, tails, cells, beyond, guess->contrast, sums);
    for (size_t cell = cells; cell < ALL_CELLS; cell++)
        sums[cell] = sums[0];
    for (size_t cell = 0; cell < ALL_CELLS; cell++) {
        pixels[cell] = scene->hidden[side][cell] / sums[cell];
        contrast[cell] = pixels[cell] * scene->richness[side][cell];
    }
    for (size_t bin = guess->bins.first; bin < guess->bins.end; bin++) {
        double *restrict here = guess->contrast[bin];
        for (size_t cell = cells; cell < ALL_CELLS; cell++)
            here[cell] = here[0];
        guess->before[bin + 1] = guess->before[bin] + weighted_sum(here, pixels);
        for (size_t cell = 0; cell < ALL_CELLS; cell++)
            here[cell] *= contrast[cell];
    }
}

int sum_light(const Rules *rules, const Scene *scene, double *pixels, double *contrast, double *guessed,
              double *guessed_contrast)
{
    const size_t bins = scene->bins;
    double *before = malloc((bins + 1 + bins * ALL_CELLS) * sizeof *before);
    if (!before)
        return -1;
    for (size_t bin = 0; bin < bins; bin++) {
        double known[ALL_CELLS];
        find_contrast(rules, scene, bin, known);
        pixels[bin] = sum_of_cells(scene->mass[bin]);
        contrast[bin] = sum_of_cells(known);
        guessed[bin] = guessed_contrast[bin] = 0.0;
    }
    const double continues = share_that_continues(rules, scene);
    for (size_t number = 0; number < GUESSES; number++)
        for (size_t side = 0; side < SIDES; side++) {
            const double chance = chance_of(number, continues);
            Guess guess = {.wanted = {0, bins}, .before = before, .contrast = (void *)(before + bins + 1)};
            guess_hidden(rules, scene, side, number, &guess);
            for (size_t bin = guess.bins.first; bin < guess.bins.end; bin++) {
                guessed[bin] += chance * (before[bin + 1] - before[bin]);
                guessed_contrast[bin] += chance * sum_of_cells(guess.contrast[bin]);
            }
        }
    free(before);
    return 0;
}
