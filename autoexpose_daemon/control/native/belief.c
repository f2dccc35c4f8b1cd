#include "belief.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "information.h"
#include "noise.h"
#include "vectorised.h"

enum { DARK, BRIGHT };

/* Compilers add up no more than one number at a time, except in lanes. */
enum { SUM_LANES = 8 };

/* What has faded to this is nothing: numbers much smaller take long. */
#define FADED 1e-200

#define LEAST_PIXELS 1e-9
#define LEAST_PRECISION 1e-12

/* What a pixel usually holds is learnt when so much of the picture is known; before, it is this (stops^2). */
#define KNOWN_SHARE 0.05
#define FIRST_RICHNESS 0.05

/* Neighbours count as spread by so much over the cells; and what is usual as much as so much of a cell. */
#define OF_OTHERS 0.1
#define OF_USUAL 0.02

/* Stops over which clipped mass may fall off. */
#define SHORTEST 0.5
#define LONGEST 50.0

/* What is hidden is somewhere, even if all has been looked at. */
#define SOMEWHERE 1e-9

/* Bins from `first` up to `end`. */
typedef struct {
    size_t first, end;
} Bins;

static double edge_of(const Rules *rules, size_t bin)
{
    return rules->lowest + rules->bin * (double)bin;
}

/* The bins that have a part between two log radiances. */
static Bins between(const Rules *rules, size_t bins, double low, double high)
{
    const double first = floor((low - rules->lowest) / rules->bin), end = ceil((high - rules->lowest) / rules->bin);
    return (Bins){(size_t)fmin(fmax(first, 0.0), (double)bins), (size_t)fmin(fmax(end, 0.0), (double)bins)};
}

/* The bins whose middles lie from one log radiance up to another. */
static Bins with_middles(const Rules *rules, size_t bins, double low, double high)
{
    const Bins within = between(rules, bins, low - rules->bin, high + rules->bin);
    Bins found = {within.end, within.end};
    for (size_t bin = within.end; bin-- > within.first;) {
        const double middle = edge_of(rules, bin) + rules->bin / 2;
        if (middle >= high)
            found.end = bin;
        if (middle >= low)
            found.first = bin;
    }
    return found;
}

static Bins common(Bins one, Bins other)
{
    const size_t first = one.first > other.first ? one.first : other.first;
    return (Bins){first, one.end < other.end ? one.end : other.end};
}

/* Those that have been looked at: the others hold nothing. */
static Bins looked_at(const Scene *scene)
{
    Bins bins = {0, scene->bins};
    while (bins.first < bins.end && scene->seen[bins.first] == 0.0)
        bins.first++;
    while (bins.first < bins.end && scene->seen[bins.end - 1] == 0.0)
        bins.end--;
    return bins;
}

static double sum_of(const double *values, size_t count)
{
    double sum = 0.0;
    for (size_t i = 0; i < count; i++)
        sum += values[i];
    return sum;
}

/* Of all cells. */
static double weighted_sum(const double values[ALL_CELLS], const double weights[ALL_CELLS])
{
    double lanes[SUM_LANES] = {0.0};
    for (size_t cell = 0; cell < ALL_CELLS; cell += SUM_LANES)
        for (size_t lane = 0; lane < SUM_LANES; lane++)
            lanes[lane] += values[cell + lane] * weights[cell + lane];
    return sum_of(lanes, SUM_LANES);
}

/* Not fmax, with which compilers vectorise nothing. */
static inline double greater(double one, double other)
{
    return one > other ? one : other;
}

static inline double contrast_of(double mass, double energy, double precision)
{
    return mass * (energy / greater(precision, LEAST_PRECISION));
}

/* -------- time */

static void forget_bin(const Scene *scene, size_t bin)
{
    for (size_t place = bin; place < ALL_CELLS * scene->bins; place += scene->bins)
        scene->mass[place] = scene->energy[place] = scene->precision[place] = 0.0;
    scene->seen[bin] = 0.0;
}

/* Replaces a share of each cell by the mean of its four neighbours, and keeps so much of that. */
VECTORISED static void diffuse(double *cells, size_t bins, Bins within, double share, double kept, double *restrict copy)
{
    const size_t width = within.end - within.first;
    for (size_t cell = 0; cell < ALL_CELLS; cell++)
        memcpy(copy + cell * width, cells + cell * bins + within.first, width * sizeof *copy);
    for (size_t cell = 0; cell < ALL_CELLS; cell++) {
        const size_t row = cell / CELLS, column = cell % CELLS;
        const double *here = copy + cell * width, *above = row ? here - CELLS * width : here,
                     *below = row + 1 < CELLS ? here + CELLS * width : here, *left = column ? here - width : here,
                     *right = column + 1 < CELLS ? here + width : here;
        double *restrict target = cells + cell * bins + within.first;
        for (size_t i = 0; i < width; i++) {
            const double around = (above[i] + below[i] + left[i] + right[i]) / 4;
            const double mixed = kept * (here[i] + share * (around - here[i]));
            target[i] = mixed < FADED ? 0.0 : mixed;
        }
    }
}

VECTORISED static void fade(double *cells, size_t bins, Bins within, double kept)
{
    for (size_t cell = 0; cell < ALL_CELLS; cell++)
        for (size_t bin = within.first; bin < within.end; bin++) {
            const double faded = kept * cells[cell * bins + bin];
            cells[cell * bins + bin] = faded < FADED ? 0.0 : faded;
        }
}

/* Moves what is known of each bin to one of more radiance. */
static void shift(double *rows, size_t count, size_t bins, ptrdiff_t risen)
{
    const size_t by = (size_t)(risen < 0 ? -risen : risen), away = by < bins ? by : bins, left = bins - away;
    for (double *row = rows; row < rows + count * bins; row += bins) {
        memmove(risen > 0 ? row + away : row, risen > 0 ? row : row + away, left * sizeof *row);
        memset(risen > 0 ? row : row + left, 0, away * sizeof *row);
    }
}

int pass_time(const Scene *scene, double kept, double moved, ptrdiff_t risen)
{
    for (size_t bin = 0; bin < scene->bins; bin++) {
        scene->seen[bin] *= kept;
        if (scene->seen[bin] < FADED && scene->seen[bin] > 0.0)
            forget_bin(scene, bin);
    }
    const Bins within = looked_at(scene);
    if (moved > 0.0) {
        double *copy = malloc((ALL_CELLS * (within.end - within.first) + 1) * sizeof *copy);
        if (!copy)
            return -1;
        diffuse(scene->mass, scene->bins, within, moved, 1.0, copy);
        diffuse(scene->energy, scene->bins, within, moved, kept * (1.0 - moved), copy);
        diffuse(scene->precision, scene->bins, within, moved, kept * (1.0 - moved), copy);
        free(copy);
    } else {
        fade(scene->energy, scene->bins, within, kept);
        fade(scene->precision, scene->bins, within, kept);
    }
    if (risen) {
        shift(scene->mass, ALL_CELLS, scene->bins, risen);
        shift(scene->energy, ALL_CELLS, scene->bins, risen);
        shift(scene->precision, ALL_CELLS, scene->bins, risen);
        shift(scene->seen, 1, scene->bins, risen);
    }
    return 0;
}

/* -------- what is hidden */

double share_that_continues(const Rules *rules, const Scene *scene)
{
    double hidden = 0.0, continues = 0.0;
    for (size_t i = 0; i < SIDES * ALL_CELLS; i++) {
        hidden += scene->hidden[i];
        continues += scene->hidden[i] / (1.0 + scene->tail[i] / rules->half_detached_tail);
    }
    return hidden == 0.0 ? 1.0 : continues / hidden;
}

/* Where one side's hidden mass lies: pixels in all bins before a bin, and contrast by bin and cell. */
typedef struct {
    Bins bins;
    double *before, *contrast; /* [bin], [bin][cell] */
} Guess;

/* likely[bin][cell] falls off over the tails, from so many stops beyond the bound on, and is less where there was a look. */
VECTORISED static void fall_off(const Rules *rules, const Scene *scene, size_t side, double away,
                                const double tails[ALL_CELLS], Bins within, double *likely, double sums[ALL_CELLS])
{
    double ratio[ALL_CELLS], falling[ALL_CELLS];
    for (size_t cell = 0; cell < ALL_CELLS; cell++) {
        ratio[cell] = exp(-rules->bin / tails[cell]);
        falling[cell] = sums[cell] = 0.0;
    }
    int begun = 0;
    for (size_t i = 0; i < within.end - within.first; i++) {
        const size_t bin = side == DARK ? within.end - 1 - i : within.first + i;
        const double beyond = fabs(edge_of(rules, bin) + rules->bin / 2 - scene->bounds[side]);
        const double unseen = 1.0 - scene->seen[bin], anywhere = SOMEWHERE * exp(-beyond / rules->longest_tail);
        double *restrict here = likely + bin * ALL_CELLS;
        if (!begun && beyond >= away) {
            begun = 1;
            for (size_t cell = 0; cell < ALL_CELLS; cell++)
                falling[cell] = exp((away - beyond) / tails[cell]);
        }
        for (size_t cell = 0; cell < ALL_CELLS; cell++) {
            here[cell] = falling[cell] * unseen + anywhere;
            sums[cell] += here[cell];
            falling[cell] *= ratio[cell];
        }
    }
}

/* Where what is hidden on a side lies: beyond the bound as far as tails reach, or detached. */
VECTORISED static void place_hidden(const Rules *rules, const Scene *scene, size_t side, int detached, Guess *guess)
{
    const double *hidden = scene->hidden + side * ALL_CELLS, *richness = scene->richness + side * ALL_CELLS;
    const double bound = scene->bounds[side];
    guess->bins = side == DARK ? with_middles(rules, scene->bins, -INFINITY, bound)
                               : with_middles(rules, scene->bins, bound, INFINITY);
    if (sum_of(hidden, ALL_CELLS) == 0.0)
        guess->bins.end = guess->bins.first;
    guess->before[guess->bins.first] = 0.0;
    if (guess->bins.first >= guess->bins.end)
        return;
    double tails[ALL_CELLS], pixels[ALL_CELLS], contrast[ALL_CELLS];
    for (size_t cell = 0; cell < ALL_CELLS; cell++)
        tails[cell] = detached ? rules->detached_tail : fmin(scene->tail[side * ALL_CELLS + cell], rules->longest_tail);
    fall_off(rules, scene, side, detached ? rules->detached : 0.0, tails, guess->bins, guess->contrast, pixels);
    for (size_t cell = 0; cell < ALL_CELLS; cell++) {
        pixels[cell] = hidden[cell] / pixels[cell];
        contrast[cell] = pixels[cell] * richness[cell];
    }
    for (size_t bin = guess->bins.first; bin < guess->bins.end; bin++) {
        double *here = guess->contrast + bin * ALL_CELLS;
        guess->before[bin + 1] = guess->before[bin] + weighted_sum(here, pixels);
        for (size_t cell = 0; cell < ALL_CELLS; cell++)
            here[cell] *= contrast[cell];
    }
}

/* -------- a frame */

/* The share of a bin of grey levels that lies in one of radiance. */
typedef struct {
    size_t grey, bin;
    double share;
} Overlap;

/* What a frame shows of the bins from `first` on: sums of a cell, and how much of each bin it shows. */
typedef struct {
    Bins bins;
    size_t overlaps;
    Overlap *overlap;                          /* in the order of grey levels, and of bins */
    double *noise, *precise, *signal;          /* [bin of grey levels] */
    double *visible;                           /* [bin] */
    double *mass, *energy, *precision, *found; /* [bin]; found: energy of all cells */
} Shown;

static void find_overlaps(const Rules *rules, const Optics *optics, double level, Shown *shown)
{
    shown->overlaps = 0;
    for (size_t grey = 1; grey + 1 < optics->bins; grey++) {
        const double low = optics->low[grey] - level, high = optics->high[grey] - level;
        const Bins within = common(between(rules, shown->bins.end, low, high), shown->bins);
        for (size_t bin = within.first; bin < within.end; bin++) {
            const double overlap = fmin(high, edge_of(rules, bin + 1)) - fmax(low, edge_of(rules, bin));
            if (overlap > 0.0 && shown->overlaps < optics->bins + shown->bins.end)
                shown->overlap[shown->overlaps++] = (Overlap){grey, bin - shown->bins.first, overlap / (high - low)};
        }
    }
}

/* Sums of a cell, from the energy and count of its gradients by grey level. */
VECTORISED static void spread_cell(const Optics *optics, const double *energy, const double *count, const Shown *shown)
{
    const Overlap *overlap = shown->overlap, *end = overlap + shown->overlaps;
    double *restrict signal = shown->signal;
    for (size_t grey = 0; grey < optics->bins; grey++)
        signal[grey] = greater(energy[grey] / 4 - count[grey] * shown->noise[grey], 0.0) * optics->inverse_slope2[grey];
    for (size_t bin = 0; bin < shown->bins.end - shown->bins.first; bin++) {
        double mass = 0.0, contrast = 0.0, precision = 0.0;
        for (; overlap < end && overlap->bin == bin; overlap++) {
            const double pixels = overlap->share * count[overlap->grey];
            mass += pixels;
            contrast += overlap->share * signal[overlap->grey];
            precision += pixels * shown->precise[overlap->grey];
        }
        shown->mass[bin] = mass;
        shown->energy[bin] = contrast;
        shown->precision[bin] = precision;
    }
}

/* What was known of a cell's bins is renewed as far as the frame shows them. */
VECTORISED static void renew_cell(const Rules *rules, const Shown *shown, double *restrict mass, double *restrict energy,
                                  double *restrict precision)
{
    for (size_t i = 0; i < shown->bins.end - shown->bins.first; i++) {
        const double left = 1.0 - rules->renewed * shown->visible[i], pixels = shown->mass[i];
        const double per_pixel = shown->energy[i] / greater(pixels, LEAST_PIXELS);
        mass[i] += shown->visible[i] * (pixels - mass[i]);
        energy[i] = left * energy[i] + shown->precision[i] * per_pixel;
        precision[i] = left * precision[i] + shown->precision[i];
        shown->found[i] += shown->energy[i];
    }
}

/* How the contrast that was guessed in what had not been looked at compares with what the frame shows of it. */
static int judge_guess(const Rules *rules, const Scene *scene, const Shown *shown, Told *told)
{
    double newest = 0.0;
    for (size_t bin = shown->bins.first; bin < shown->bins.end; bin++)
        newest = fmax(newest, shown->visible[bin - shown->bins.first] * (1.0 - scene->seen[bin]));
    told->guessed = weighted_sum(scene->hidden, scene->richness) +
                    weighted_sum(scene->hidden + ALL_CELLS, scene->richness + ALL_CELLS);
    if (newest < rules->least_look || told->guessed == 0.0) /* no more than `newest` of it can be expected */
        return 0;
    double *tables = malloc((scene->bins * (1 + ALL_CELLS) + 1) * sizeof *tables);
    if (!tables)
        return -1;
    const double continues = share_that_continues(rules, scene);
    for (int detached = 0; detached < 2; detached++)
        for (size_t side = 0; side < SIDES; side++) {
            Guess guess = {.before = tables, .contrast = tables + scene->bins + 1};
            place_hidden(rules, scene, side, detached, &guess);
            const Bins looked = common(guess.bins, shown->bins);
            for (size_t bin = looked.first; bin < looked.end; bin++)
                told->expected += (detached ? 1.0 - continues : continues) * (1.0 - scene->seen[bin]) *
                                  shown->visible[bin - shown->bins.first] * sum_of(guess.contrast + bin * ALL_CELLS, ALL_CELLS);
        }
    free(tables);
    for (size_t bin = shown->bins.first; bin < shown->bins.end; bin++)
        told->found += shown->found[bin - shown->bins.first] * shown->visible[bin - shown->bins.first] * (1.0 - scene->seen[bin]);
    return 0;
}

/* -------- bounds */

static double sum_within(const double *row, Bins bins)
{
    return bins.first < bins.end ? sum_of(row + bins.first, bins.end - bins.first) : 0.0;
}

/* What a pixel of the scene usually holds, from what is known of it; known[cell][bin] is written. */
VECTORISED static double usual_richness(const Scene *scene, Bins bins, double picture, double before, double *known)
{
    double pixels = 0.0, contrast = 0.0;
    for (size_t row = 0; row < ALL_CELLS * scene->bins; row += scene->bins) {
        for (size_t bin = bins.first; bin < bins.end; bin++)
            known[row + bin] = contrast_of(scene->mass[row + bin], scene->energy[row + bin], scene->precision[row + bin]);
        pixels += sum_within(scene->mass + row, bins);
        contrast += sum_within(known + row, bins);
    }
    if (before != 0.0 && pixels <= KNOWN_SHARE * picture)
        return before;
    const double richness = contrast / fmax(pixels, LEAST_PIXELS);
    return richness != 0.0 ? richness : FIRST_RICHNESS;
}

/* No more mass is kept beyond a bound than is clipped there; the rest of that is hidden, and like what is beside it. */
static void hide(const Rules *rules, const Scene *scene, size_t side, Bins looked, const double *clipped, size_t stride,
                 const double *by_cell, double usual, const double *known)
{
    const double bound = scene->bounds[side], reach = rules->neighbours[side];
    const Bins beyond = common(looked, side == DARK ? with_middles(rules, scene->bins, -INFINITY, bound)
                                                    : with_middles(rules, scene->bins, bound, INFINITY));
    const Bins beside = common(looked, side == DARK ? with_middles(rules, scene->bins, bound, bound + reach)
                                                    : with_middles(rules, scene->bins, bound - reach, bound));
    double *hidden = scene->hidden + side * ALL_CELLS, neighbours[ALL_CELLS];
    for (size_t cell = 0; cell < ALL_CELLS; cell++) {
        double *mass = scene->mass + cell * scene->bins;
        const double remembered = sum_within(mass, beyond);
        const double kept = fmin(clipped[cell * stride] / fmax(remembered, LEAST_PIXELS), 1.0);
        for (size_t bin = beyond.first; bin < beyond.end; bin++)
            mass[bin] *= kept;
        hidden[cell] = fmax(clipped[cell * stride] - remembered, 0.0);
        neighbours[cell] = sum_within(mass, beside);
    }
    const double others = OF_OTHERS * sum_of(neighbours, ALL_CELLS) / ALL_CELLS;
    for (size_t cell = 0; cell < ALL_CELLS; cell++) {
        const double density = (neighbours[cell] + others) / reach, usually = OF_USUAL * by_cell[cell];
        const double contrast = sum_within(known + cell * scene->bins, beside) + usually * usual;
        scene->tail[side * ALL_CELLS + cell] = fmin(fmax(hidden[cell] / fmax(density, LEAST_PIXELS), SHORTEST), LONGEST);
        scene->richness[side * ALL_CELLS + cell] = contrast / fmax(neighbours[cell] + usually, LEAST_PIXELS);
    }
}

/* `numbers`: room for the tables of a frame. */
static int see(const Rules *rules, const Scene *scene, const Optics *optics, const Frame *frame, double *by_cell,
               Told *told, Shown *shown, double *numbers)
{
    const size_t greys = optics->bins, bins = scene->bins, last = greys - 1;
    const double black = optics->low[1] - frame->level, saturated = optics->low[last] - frame->level;
    shown->bins = between(rules, bins, black, saturated);
    double *noise = shown->noise = numbers, *precise = shown->precise = numbers + greys;
    shown->signal = precise + greys;
    shown->visible = shown->signal + greys;
    shown->mass = shown->visible + bins;
    shown->energy = shown->mass + bins;
    shown->precision = shown->energy + bins;
    shown->found = shown->precision + bins;
    double *known = shown->found + bins;
    find_overlaps(rules, optics, frame->level, shown);
    CellContrast cells[ALL_CELLS];
    for (size_t grey = 0; grey < greys; grey++)
        noise[grey] = variance_of(optics->shot[grey] * frame->gain + optics->read[grey] * (frame->gain * frame->gain),
                                  frame->averaged);
    for (size_t cell = 0; cell < ALL_CELLS; cell++) {
        cells[cell] = cell_contrast(greys, optics->readable, noise, frame->energy + cell * greys,
                                    frame->count + cell * greys);
        by_cell[cell] = cells[cell].weight;
    }
    told->noise_share = share_of_noise(cells);
    for (size_t grey = 0; grey < greys; grey++) {
        noise[grey] *= told->noise_share;
        const double precision = optics->slope2[grey] / (noise[grey] + FRONT_END_DN * FRONT_END_DN);
        precise[grey] = precision * precision;
    }
    for (size_t bin = shown->bins.first; bin < shown->bins.end; bin++) {
        const double part = fmin(saturated, edge_of(rules, bin + 1)) - fmax(black, edge_of(rules, bin));
        shown->visible[bin - shown->bins.first] = fmax(part, 0.0) / rules->bin;
        shown->found[bin - shown->bins.first] = 0.0;
    }
    for (size_t cell = 0; cell < ALL_CELLS; cell++) {
        const size_t place = cell * bins + shown->bins.first;
        spread_cell(optics, frame->energy + cell * greys, frame->count + cell * greys, shown);
        renew_cell(rules, shown, scene->mass + place, scene->energy + place, scene->precision + place);
    }
    if (judge_guess(rules, scene, shown, told))
        return -1;
    for (size_t bin = shown->bins.first; bin < shown->bins.end; bin++)
        scene->seen[bin] = fmax(scene->seen[bin], shown->visible[bin - shown->bins.first]);
    const Bins looked = looked_at(scene);
    told->usual_richness = usual_richness(scene, looked, sum_of(by_cell, ALL_CELLS), told->usual_richness, known);
    scene->bounds[DARK] = black;
    scene->bounds[BRIGHT] = saturated;
    hide(rules, scene, BRIGHT, looked, frame->count + last, greys, by_cell, told->usual_richness, known);
    hide(rules, scene, DARK, looked, frame->count, greys, by_cell, told->usual_richness, known);
    return 0;
}

int see_frame(const Rules *rules, const Scene *scene, const Optics *optics, const Frame *frame, double *by_cell,
              Told *told)
{
    Shown shown = {.overlap = malloc((optics->bins + scene->bins) * sizeof *shown.overlap)};
    double *numbers = malloc((3 * optics->bins + (5 + ALL_CELLS) * scene->bins) * sizeof *numbers);
    const int failed = !shown.overlap || !numbers || see(rules, scene, optics, frame, by_cell, told, &shown, numbers);
    free(shown.overlap);
    free(numbers);
    return failed ? -1 : 0;
}

/* -------- outlook */

/* The scene as outlooks see it: cells in the order of the light that they get. */
typedef struct {
    size_t order[ALL_CELLS];
    double light[ALL_CELLS], weights[ALL_CELLS], favoured[ALL_CELLS]; /* weights sum to 1 */
    double unit;                                                      /* 1 / pixels of a cell */
    Bins looked;
    double *known;               /* [bin][cell], contrast that was seen */
    Guess guesses[SIDES][SIDES]; /* [whether it continues, or is detached][side] */
    double *worth, *at;          /* [bin], and for each sample of it */
} View;

static void sort_by_light(const double light[ALL_CELLS], View *view)
{
    for (size_t cell = 0; cell < ALL_CELLS; cell++) {
        size_t place = cell;
        for (; place && light[view->order[place - 1]] > light[cell]; place--)
            view->order[place] = view->order[place - 1];
        view->order[place] = cell;
    }
    for (size_t cell = 0; cell < ALL_CELLS; cell++)
        view->light[cell] = light[view->order[cell]];
}

static void sort_cells(const double values[ALL_CELLS], const size_t order[ALL_CELLS], double sorted[ALL_CELLS])
{
    for (size_t cell = 0; cell < ALL_CELLS; cell++)
        sorted[cell] = values[order[cell]];
}

/* How much each cell counts in a mean; favours may be NULL. */
static void weigh_cells(const Outlooks *frames, const View *view, const double *favours, double weights[ALL_CELLS])
{
    for (size_t cell = 0; cell < ALL_CELLS; cell++) {
        const size_t place = view->order[cell];
        weights[cell] = frames->by_cell[place] > 0.0 ? (favours ? favours[place] : 1.0) : 0.0;
    }
    const double sum = fmax(sum_of(weights, ALL_CELLS), LEAST_PIXELS);
    for (size_t cell = 0; cell < ALL_CELLS; cell++)
        weights[cell] /= sum;
}

/* 1 / pixels of a cell, in the mean. */
static double unit_of(const double by_cell[ALL_CELLS])
{
    double cells = 0.0;
    for (size_t cell = 0; cell < ALL_CELLS; cell++)
        cells += by_cell[cell] != 0.0;
    return cells / fmax(sum_of(by_cell, ALL_CELLS), 1.0);
}

VECTORISED static void recall(const Scene *scene, View *view)
{
    view->looked = looked_at(scene);
    for (size_t cell = 0; cell < ALL_CELLS; cell++) {
        const size_t row = view->order[cell] * scene->bins;
        for (size_t bin = view->looked.first; bin < view->looked.end; bin++)
            view->known[bin * ALL_CELLS + cell] =
                contrast_of(scene->mass[row + bin], scene->energy[row + bin], scene->precision[row + bin]);
    }
}

/* Where what is hidden lies, by both hypotheses; `numbers`: room for their tables. */
static void guess_hidden(const Rules *rules, const Scene *scene, View *view, double *numbers)
{
    double sorted[3 * SIDES * ALL_CELLS];
    Scene of_view = *scene;
    of_view.hidden = sorted;
    of_view.tail = sorted + SIDES * ALL_CELLS;
    of_view.richness = sorted + 2 * SIDES * ALL_CELLS;
    for (size_t first = 0; first < SIDES * ALL_CELLS; first += ALL_CELLS) {
        sort_cells(scene->hidden + first, view->order, of_view.hidden + first);
        sort_cells(scene->tail + first, view->order, of_view.tail + first);
        sort_cells(scene->richness + first, view->order, of_view.richness + first);
    }
    for (int detached = 0; detached < 2; detached++) {
        double *contrast = numbers; /* of both sides, which have no bins in common */
        numbers += scene->bins * ALL_CELLS;
        for (size_t side = 0; side < SIDES; side++, numbers += scene->bins + 1) {
            Guess *guess = &view->guesses[detached][side];
            *guess = (Guess){.before = numbers, .contrast = contrast};
            place_hidden(rules, &of_view, side, detached, guess);
        }
    }
}

/* What squared contrast in bins is worth in a frame, where the lens lets so much light through. */
VECTORISED static void find_worth(const Rules *rules, const Optics *optics, const Outlooks *frames, size_t frame,
                                  double light, Bins bins, const View *view)
{
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

/* Adds what the contrast of cells is worth. */
VECTORISED static void add_worth(const double *contrast, const double *worth, Bins bins, size_t first, size_t end,
                                 double *restrict found)
{
    for (size_t bin = bins.first; bin < bins.end; bin++)
        for (size_t cell = first; cell < end; cell++)
            found[cell] += worth[bin] * contrast[bin * ALL_CELLS + cell];
}

/* The root of what the mean pixel of each cell holds. */
VECTORISED static void find_roots(double *restrict found, double unit)
{
    for (size_t cell = 0; cell < ALL_CELLS; cell++)
        found[cell] = sqrt(greater(found[cell], 0.0) * unit);
}

/* The share of what is hidden that lies in bins. */
static double share_in(const Guess sides[SIDES], Bins bins)
{
    double within = 0.0, all = 0.0;
    for (const Guess *guess = sides; guess < sides + SIDES; guess++) {
        const Bins shared = common(guess->bins, bins);
        all += guess->before[guess->bins.end];
        within += shared.first < shared.end ? guess->before[shared.end] - guess->before[shared.first] : 0.0;
    }
    return within / fmax(all, LEAST_PIXELS);
}

static void look_at(const Rules *rules, const Scene *scene, const Optics *optics, const Outlooks *frames, size_t frame,
                    const View *view, double *information, double *favoured, double *revealed)
{
    const double level = frames->levels[frame], lowest = (double)optics->first * optics->step;
    const double highest = lowest + (double)optics->places * optics->step;
    const Bins reached = between(rules, scene->bins, lowest - level, highest - level);
    const Bins shown = with_middles(rules, scene->bins, optics->low[1] - level, optics->low[optics->bins - 1] - level);
    double found[HYPOTHESES][ALL_CELLS] = {{0.0}};
    for (size_t first = 0, end; first < ALL_CELLS; first = end) {
        for (end = first; end < ALL_CELLS && view->light[end] == view->light[first];)
            end++;
        find_worth(rules, optics, frames, frame, view->light[first], reached, view);
        add_worth(view->known, view->worth, common(reached, view->looked), first, end, found[0]);
        for (size_t guess = 0; guess < 2; guess++) {
            memcpy(found[1 + guess] + first, found[0] + first, (end - first) * sizeof **found);
            for (size_t side = 0; side < SIDES; side++)
                add_worth(view->guesses[guess][side].contrast, view->worth,
                          common(reached, view->guesses[guess][side].bins), first, end, found[1 + guess]);
        }
    }
    for (size_t hypothesis = 0; hypothesis < HYPOTHESES; hypothesis++) {
        const size_t place = hypothesis * frames->count + frame;
        find_roots(found[hypothesis], view->unit);
        information[place] = weighted_sum(found[hypothesis], view->weights);
        if (favoured)
            favoured[place] = weighted_sum(found[hypothesis], view->favoured);
        revealed[place] = share_in(view->guesses[hypothesis == HYPOTHESES - 1], shown);
    }
}

int look_out(const Rules *rules, const Scene *scene, const Optics *optics, const Outlooks *frames, double *information,
             double *favoured, double *revealed)
{
    View view;
    double *numbers = malloc(((scene->bins + 1) * (3 * ALL_CELLS + 2 * SIDES + 1 + SAMPLES)) * sizeof *numbers);
    if (!numbers)
        return -1;
    view.known = numbers;
    view.worth = view.known + scene->bins * ALL_CELLS;
    view.at = view.worth + scene->bins;
    sort_by_light(frames->light, &view);
    weigh_cells(frames, &view, NULL, view.weights);
    weigh_cells(frames, &view, frames->favours, view.favoured);
    recall(scene, &view);
    view.unit = unit_of(frames->by_cell);
    guess_hidden(rules, scene, &view, view.at + scene->bins * SAMPLES);
    for (size_t frame = 0; frame < frames->count; frame++)
        look_at(rules, scene, optics, frames, frame, &view, information, favoured, revealed);
    free(numbers);
    return 0;
}
