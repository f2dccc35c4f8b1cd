#include "belief.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "hidden.h"
#include "noise.h"
#include "picture/vectorised.h"

/* What has faded to this is nothing: numbers much smaller take long. */
#define FADED 1e-200

/* What a pixel usually holds is learnt when so much of the picture is known, and is at least this (stops^2). */
#define KNOWN_SHARE 0.05
#define LEAST_RICHNESS 1e-3

/* Neighbours count as spread by so much over the cells; and what is usual as much as so much of a cell. */
#define OF_OTHERS 0.1
#define OF_USUAL 0.02

/* Stops over which clipped mass may fall off. */
#define SHORTEST 0.5
#define LONGEST 50.0

/* -------- time */

static void forget_bin(const Scene *scene, size_t bin)
{
    memset(scene->mass[bin], 0, sizeof *scene->mass);
    memset(scene->energy[bin], 0, sizeof *scene->energy);
    memset(scene->precision[bin], 0, sizeof *scene->precision);
    scene->seen[bin] = 0.0;
}

/* Keeps so much of each cell. */
VECTORISED static void fade(double cells[ALL_CELLS], double kept)
{
    for (size_t cell = 0; cell < ALL_CELLS; cell++)
        cells[cell] = kept * cells[cell] < FADED ? 0.0 : kept * cells[cell];
}

/* Replaces a share of each cell by the mean of its four neighbours. */
VECTORISED static void diffuse(double cells[ALL_CELLS], double share)
{
    double wide[CELLS + 2][CELLS + 2];
    for (size_t row = 0; row < CELLS + 2; row++) {
        const double *here = cells + CELLS * (row == 0 ? 0 : row > CELLS ? CELLS - 1 : row - 1);
        memcpy(wide[row] + 1, here, CELLS * sizeof *here);
        wide[row][0] = here[0];
        wide[row][CELLS + 1] = here[CELLS - 1];
    }
    for (size_t row = 1; row <= CELLS; row++)
        for (size_t column = 1; column <= CELLS; column++) {
            const double here = wide[row][column], around = (wide[row - 1][column] + wide[row + 1][column] +
                                                             wide[row][column - 1] + wide[row][column + 1]) / 4;
            cells[(row - 1) * CELLS + column - 1] = here + share * (around - here);
        }
}

/* Moves what is known of each of `bins`, of `size` bytes, to one of more radiance. */
static void shift(void *first, size_t bins, size_t size, ptrdiff_t risen)
{
    const size_t by = (size_t)(risen < 0 ? -risen : risen), away = (by < bins ? by : bins) * size, all = bins * size;
    char *low = first;
    memmove(risen > 0 ? low + away : low, risen > 0 ? low : low + away, all - away);
    memset(risen > 0 ? low : low + all - away, 0, away);
}

void pass_time(const Scene *scene, double kept, double moved, ptrdiff_t risen)
{
    const Bins looked = bins_looked_at(scene);
    for (size_t bin = looked.first; bin < looked.end; bin++) {
        if (moved > 0.0) {
            diffuse(scene->mass[bin], moved);
            diffuse(scene->energy[bin], moved);
            diffuse(scene->precision[bin], moved);
        }
        fade(scene->energy[bin], kept * (1.0 - moved));
        fade(scene->precision[bin], kept * (1.0 - moved));
        scene->seen[bin] *= kept * (1.0 - moved / CELLS); /* by so much the picture is new */
        if (scene->seen[bin] < FADED)
            forget_bin(scene, bin);
    }
    if (risen) {
        shift(scene->mass, scene->bins, sizeof *scene->mass, risen);
        shift(scene->energy, scene->bins, sizeof *scene->energy, risen);
        shift(scene->precision, scene->bins, sizeof *scene->precision, risen);
        shift(scene->seen, scene->bins, sizeof *scene->seen, risen);
    }
}

/* -------- what a frame shows */

/* Of the bins from `bins.first` on, or of bins of grey levels. */
typedef struct {
    Bins bins;
    double black, saturated;                             /* log radiance */
    double (*gradients)[ALL_CELLS], (*count)[ALL_CELLS]; /* [grey][cell]: of the frame; then its signal, and count */
    double *noise, *precise;                             /* [grey], variance, and squared precision of a pixel */
    double *visible, *found;                             /* [bin], its share that is shown, and energy of all cells */
    double (*mass)[ALL_CELLS], (*energy)[ALL_CELLS], (*precision)[ALL_CELLS]; /* [bin][cell] */
} Shown;

/* By grey level and cell instead of by cell and grey level. */
static void turn(const double *from, size_t greys, double (*to)[ALL_CELLS])
{
    for (size_t grey = 0; grey < greys; grey++)
        for (size_t cell = 0; cell < ALL_CELLS; cell++)
            to[grey][cell] = from[cell * greys + grey];
}

/* Sums of each cell. */
VECTORISED static void sum_up(const Optics *optics, const Shown *shown, Cell cells[ALL_CELLS])
{
    double energy[ALL_CELLS] = {0.0}, expected[ALL_CELLS] = {0.0}, readable[ALL_CELLS] = {0.0}, all[ALL_CELLS] = {0.0};
    for (size_t grey = 0; grey < optics->bins; grey++)
        for (size_t cell = 0; cell < ALL_CELLS; cell++) {
            energy[cell] += shown->gradients[grey][cell] / 4 * optics->readable[grey];
            expected[cell] += shown->count[grey][cell] * (shown->noise[grey] * optics->readable[grey]);
            readable[cell] += shown->count[grey][cell] * optics->readable[grey];
            all[cell] += shown->count[grey][cell];
        }
    for (size_t cell = 0; cell < ALL_CELLS; cell++)
        cells[cell] = (Cell){energy[cell], expected[cell], readable[cell], all[cell]};
}

/* Leaves of the gradients what noise did not make, in stops. */
VECTORISED static void subtract_noise(const Optics *optics, const Shown *shown)
{
    for (size_t grey = 0; grey < optics->bins; grey++) {
        double *restrict gradients = shown->gradients[grey];
        for (size_t cell = 0; cell < ALL_CELLS; cell++)
            gradients[cell] = greater(gradients[cell] / 4 - shown->count[grey][cell] * shown->noise[grey], 0.0) *
                              optics->inverse_slope2[grey];
    }
}

/* Adds a share of a bin of grey levels to one of radiance. */
VECTORISED static void add_share(const Shown *shown, size_t grey, size_t bin, double share)
{
    const double *gradients = shown->gradients[grey], *count = shown->count[grey];
    double *restrict mass = shown->mass[bin], *restrict energy = shown->energy[bin];
    double *restrict precision = shown->precision[bin];
    for (size_t cell = 0; cell < ALL_CELLS; cell++) {
        mass[cell] += share * count[cell];
        energy[cell] += share * gradients[cell];
        precision[cell] += share * shown->precise[grey] * count[cell];
    }
}

static void spread(const Rules *rules, const Optics *optics, double level, const Shown *shown)
{
    const size_t first = shown->bins.first;
    memset(shown->mass, 0, 3 * (shown->bins.end - first) * sizeof *shown->mass); /* and energy, and precision */
    for (size_t grey = 1; grey + 1 < optics->bins; grey++) {
        const double low = optics->low[grey] - level, high = optics->high[grey] - level;
        const Bins within = common(bins_between(rules, shown->bins.end, low, high), shown->bins);
        for (size_t bin = within.first; bin < within.end; bin++) {
            const double overlap = fmin(high, edge_of(rules, bin + 1)) - fmax(low, edge_of(rules, bin));
            add_share(shown, grey, bin - first, fmax(overlap, 0.0) / (high - low));
        }
    }
    for (size_t bin = first; bin < shown->bins.end; bin++) {
        const double part = fmin(shown->saturated, edge_of(rules, bin + 1)) - fmax(shown->black, edge_of(rules, bin));
        shown->visible[bin - first] = fmax(part, 0.0) / rules->bin;
        shown->found[bin - first] = sum_of_cells(shown->energy[bin - first]);
    }
}

/* How the contrast that was guessed in what had not been looked at compares with what the frame shows of it. */
static int judge_guess(const Rules *rules, const Scene *scene, const Shown *shown, Told *told)
{
    const size_t first = shown->bins.first;
    double newest = 0.0;
    for (size_t bin = first; bin < shown->bins.end; bin++)
        newest = fmax(newest, shown->visible[bin - first] * (1.0 - scene->seen[bin]));
    for (size_t side = 0; side < SIDES; side++)
        told->guessed += weighted_sum(scene->hidden[side], scene->richness[side]);
    if (newest < rules->least_look || told->guessed == 0.0) /* no more than `newest` of it can be expected */
        return 0;
    double *before = malloc((scene->bins + 1) * (1 + ALL_CELLS) * sizeof *before);
    if (!before)
        return -1;
    const double continues = share_that_continues(rules, scene);
    for (size_t number = 0; number < GUESSES; number++)
        for (size_t side = 0; side < SIDES; side++) {
            Guess guess = {.wanted = shown->bins, .before = before, .contrast = (void *)(before + scene->bins + 1)};
            guess_hidden(rules, scene, side, number, &guess);
            for (size_t bin = guess.bins.first; bin < guess.bins.end; bin++)
                told->expected += chance_of(number, continues) * shown->visible[bin - first] *
                                  (1.0 - scene->seen[bin]) * sum_of_cells(guess.contrast[bin]);
        }
    free(before);
    for (size_t bin = first; bin < shown->bins.end; bin++)
        told->found += shown->found[bin - first] * shown->visible[bin - first] * (1.0 - scene->seen[bin]);
    return 0;
}

/* What was known of a bin is renewed as far as the frame shows it. */
VECTORISED static void renew(const Rules *rules, const Scene *scene, const Shown *shown, size_t bin)
{
    const size_t at = bin - shown->bins.first;
    const double visible = shown->visible[at], left = 1.0 - rules->renewed * visible;
    const double *pixels = shown->mass[at], *found = shown->energy[at], *precise = shown->precision[at];
    double *restrict mass = scene->mass[bin], *restrict energy = scene->energy[bin];
    double *restrict precision = scene->precision[bin];
    for (size_t cell = 0; cell < ALL_CELLS; cell++) {
        mass[cell] += visible * (pixels[cell] - mass[cell]);
        energy[cell] = left * energy[cell] + precise[cell] * found[cell] / greater(pixels[cell], LEAST_PIXELS);
        precision[cell] = left * precision[cell] + precise[cell];
    }
    scene->seen[bin] = fmax(scene->seen[bin], visible);
}

/* -------- bounds */

VECTORISED static void add_cells(const double cells[ALL_CELLS], double *restrict sums)
{
    for (size_t cell = 0; cell < ALL_CELLS; cell++)
        sums[cell] += cells[cell];
}

/* What a pixel of the scene usually holds, from what is surely known of it. */
VECTORISED static double usual_richness(const Rules *rules, const Scene *scene, Bins looked, double picture)
{
    const double unsure = rules->unsure / (scene->usual_richness * scene->usual_richness);
    double pixels = 0.0, contrast = 0.0, known[ALL_CELLS], sure[ALL_CELLS];
    for (size_t bin = looked.first; bin < looked.end; bin++) {
        for (size_t cell = 0; cell < ALL_CELLS; cell++)
            sure[cell] = scene->precision[bin][cell] / (scene->precision[bin][cell] + unsure);
        find_contrast(rules, scene, bin, known);
        pixels += weighted_sum(scene->mass[bin], sure);
        contrast += weighted_sum(known, sure);
    }
    return pixels > KNOWN_SHARE * picture ? fmax(contrast / pixels, LEAST_RICHNESS) : scene->usual_richness;
}

/* No more mass is kept beyond a bound than is clipped there; the rest of that is hidden. */
VECTORISED static void bound(const Scene *scene, size_t side, Bins beyond, const double *clipped)
{
    double remembered[ALL_CELLS] = {0.0}, kept[ALL_CELLS], *restrict hidden = scene->hidden[side];
    for (size_t bin = beyond.first; bin < beyond.end; bin++)
        add_cells(scene->mass[bin], remembered);
    for (size_t cell = 0; cell < ALL_CELLS; cell++) {
        kept[cell] = lesser(clipped[cell] / greater(remembered[cell], LEAST_PIXELS), 1.0);
        hidden[cell] = greater(clipped[cell] - remembered[cell], 0.0);
    }
    for (size_t bin = beyond.first; bin < beyond.end; bin++)
        for (size_t cell = 0; cell < ALL_CELLS; cell++)
            scene->mass[bin][cell] *= kept[cell];
}

/* What is hidden is like what is beside it. */
VECTORISED static void liken(const Rules *rules, const Scene *scene, size_t side, Bins beside, const double *by_cell)
{
    const double reach = rules->neighbours[side], usual = scene->usual_richness;
    double pixels[ALL_CELLS] = {0.0}, contrast[ALL_CELLS] = {0.0}, known[ALL_CELLS];
    double *restrict tail = scene->tail[side], *restrict richness = scene->richness[side];
    for (size_t bin = beside.first; bin < beside.end; bin++) {
        find_contrast(rules, scene, bin, known);
        add_cells(scene->mass[bin], pixels);
        add_cells(known, contrast);
    }
    const double others = OF_OTHERS * sum_of_cells(pixels) / ALL_CELLS;
    for (size_t cell = 0; cell < ALL_CELLS; cell++) {
        const double density = (pixels[cell] + others) / reach, usually = OF_USUAL * by_cell[cell];
        tail[cell] = lesser(greater(scene->hidden[side][cell] / greater(density, LEAST_PIXELS), SHORTEST), LONGEST);
        richness[cell] = (contrast[cell] + usually * usual) / greater(pixels[cell] + usually, LEAST_PIXELS);
    }
}

static int see(const Rules *rules, Scene *scene, const Optics *optics, const Frame *frame, const Shown *shown,
               double *by_cell, Told *told)
{
    const size_t greys = optics->bins;
    Cell cells[ALL_CELLS];
    turn(frame->energy, greys, shown->gradients);
    turn(frame->count, greys, shown->count);
    for (size_t grey = 0; grey < greys; grey++)
        shown->noise[grey] = variance_of(
            optics->shot[grey] * frame->gain + optics->read[grey] * (frame->gain * frame->gain), frame->averaged);
    sum_up(optics, shown, cells);
    told->noise_share = share_of_noise(cells);
    for (size_t grey = 0; grey < greys; grey++) {
        shown->noise[grey] *= told->noise_share;
        const double precision = optics->slope2[grey] / (shown->noise[grey] + FRONT_END_DN * FRONT_END_DN);
        shown->precise[grey] = precision * precision;
    }
    subtract_noise(optics, shown);
    spread(rules, optics, frame->level, shown);
    if (judge_guess(rules, scene, shown, told))
        return -1;
    for (size_t bin = shown->bins.first; bin < shown->bins.end; bin++)
        renew(rules, scene, shown, bin);
    for (size_t cell = 0; cell < ALL_CELLS; cell++)
        by_cell[cell] = cells[cell].weight;
    scene->bounds[DARK] = shown->black;
    scene->bounds[BRIGHT] = shown->saturated;
    const Bins looked = bins_looked_at(scene);
    scene->usual_richness = usual_richness(rules, scene, looked, sum_of_cells(by_cell));
    for (size_t side = SIDES; side-- > 0;) {
        const double reach = rules->neighbours[side], from = scene->bounds[side] - (side == BRIGHT ? reach : 0.0);
        const Bins beside = common(looked, bins_with_middles(rules, scene->bins, from, from + reach));
        bound(scene, side, common(looked, bins_beyond(rules, scene, side)), shown->count[side == DARK ? 0 : greys - 1]);
        liken(rules, scene, side, beside, by_cell);
    }
    return 0;
}

int see_frame(const Rules *rules, Scene *scene, const Optics *optics, const Frame *frame, double *by_cell,
              Told *told)
{
    const size_t greys = optics->bins;
    const double black = optics->low[1] - frame->level, saturated = optics->low[greys - 1] - frame->level;
    const Bins bins = bins_between(rules, scene->bins, black, saturated);
    const size_t count = bins.end - bins.first;
    double(*tables)[ALL_CELLS] = malloc((2 * greys + 3 * count) * sizeof *tables + 2 * (greys + count) * sizeof **tables);
    if (!tables)
        return -1;
    double *numbers = (double *)(tables + 2 * greys + 3 * count);
    const Shown shown = {.bins = bins,
                         .black = black,
                         .saturated = saturated,
                         .gradients = tables,
                         .count = tables + greys,
                         .mass = tables + 2 * greys,
                         .energy = tables + 2 * greys + count,
                         .precision = tables + 2 * greys + 2 * count,
                         .noise = numbers,
                         .precise = numbers + greys,
                         .visible = numbers + 2 * greys,
                         .found = numbers + 2 * greys + count};
    const int failed = see(rules, scene, optics, frame, &shown, by_cell, told);
    free(tables);
    return failed;
}
