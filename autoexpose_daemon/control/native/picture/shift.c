#include "shift.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "vectorised.h"

/* Sizes of the picture that it is followed through, each half the one before; the last is searched. */
enum { SIZES = 3 };

/* Blocks of the smallest size by which the picture may have moved, across and down. */
enum { REACH_ACROSS = 5, REACH_DOWN = 3 };

/* Parts of the picture that move by themselves. */
enum { TILES_ACROSS = 4, TILES_DOWN = 3, TILES = TILES_ACROSS * TILES_DOWN };

/* Gauss-Newton steps at each size. */
static const int steps_at[SIZES] = {1, 2, 0};

/* Variance of the difference between two blocks that show the same, 1/128 stop squared: 0.022 stop. */
#define NOISE 8.2

/* How much worse pictures may agree for each block that they have moved less: where a texture repeats itself. */
#define NEARER 0.03

/* Squared gradient, per block, below which nothing is sure, and the part that tiles take from the whole picture. */
#define LEAST_GRADIENT 0.16
#define OF_THE_WHOLE 0.03

/* Share of the blocks that must be neither black nor white in both pictures. */
#define LEAST_SHARE 0.01

typedef struct {
    int16_t *before, *now;
    ptrdiff_t height, width;
} Pictures;

typedef struct {
    double x, y;
} Shift;

/* Normal equations of a shift: squared gradients, their product with what the shift has to explain, and of how many. */
typedef struct {
    double xx, xy, yy, x, y, count;
} Equations;

static inline ptrdiff_t lesser(ptrdiff_t a, ptrdiff_t b)
{
    return a < b ? a : b;
}

static inline ptrdiff_t greater(ptrdiff_t a, ptrdiff_t b)
{
    return a > b ? a : b;
}

/* The sums of columns of `side` rows, four of which make a block: compilers vectorise what has a fixed number. */
VECTORISED static void sum_fours(const uint16_t *restrict columns, size_t count, uint16_t *restrict sums)
{
    for (size_t block = 0; block < count; block++) {
        const uint16_t *four = columns + 4 * block;
        sums[block] = (uint16_t)(four[0] + four[1] + four[2] + four[3]);
    }
}

VECTORISED static void add_row(const uint8_t *restrict row, size_t width, uint16_t *restrict columns)
{
    for (size_t x = 0; x < width; x++)
        columns[x] = (uint16_t)(columns[x] + row[x]);
}

int light_of_blocks(const Image *image, size_t side, const int16_t *light_of_sum, int16_t *light)
{
    const size_t width = image->width / side, height = image->height / side;
    uint16_t *columns = malloc((image->width + width) * sizeof *columns + image->width), *sums = columns + image->width;
    if (!columns)
        return -1;
    for (size_t y = 0; y < height; y++) {
        memset(columns, 0, image->width * sizeof *columns);
        for (size_t line = 0; line < side; line++)
            add_row(row_in(image, y * side + line, (uint8_t *)(sums + width)), image->width, columns);
        if (side == 4)
            sum_fours(columns, width, sums);
        else
            for (size_t block = 0; block < width; block++) {
                sums[block] = 0;
                for (size_t x = 0; x < side; x++)
                    sums[block] = (uint16_t)(sums[block] + columns[block * side + x]);
            }
        for (size_t block = 0; block < width; block++)
            light[y * width + block] = light_of_sum[sums[block]];
    }
    free(columns);
    return 0;
}

/* By how much light has risen, by blocks that are neither black nor white in both; 0 if they are too few. */
VECTORISED static int rise_of(const int16_t *before, const int16_t *now, size_t count, int16_t brightest, int16_t *rise)
{
    int sum = 0, used = 0;
    for (size_t i = 0; i < count; i++) {
        const int16_t inside = before[i] > 0 && before[i] < brightest && now[i] > 0 && now[i] < brightest;
        const int16_t change = (int16_t)(now[i] - before[i]);
        used += inside;
        sum += inside ? change : 0;
    }
    if (used < LEAST_SHARE * (double)count)
        return 0;
    *rise = (int16_t)lrint((double)sum / used);
    return 1;
}

static inline int16_t blurred(int16_t a, int16_t b, int16_t c, int16_t d, int16_t e)
{
    return (int16_t)((int16_t)(a + e + 4 * (b + d) + 6 * c + 8) >> 4); /* at most 16 * BRIGHTEST + 8: fits */
}

/* What both pictures can show, after the light has risen, blurred by 1 4 6 4 1 both ways; `across`: room. */
VECTORISED static void blur(const int16_t *restrict light, ptrdiff_t height, ptrdiff_t width, int16_t rise, int16_t low,
                            int16_t high, int16_t *restrict across, int16_t *restrict blur_of)
{
    int16_t row[MOST_BLOCKS + 4];
    for (ptrdiff_t y = 0; y < height; y++) {
        for (ptrdiff_t x = 0; x < width; x++) {
            const int16_t risen = (int16_t)(light[y * width + x] + rise), least = risen > low ? risen : low;
            row[x + 2] = least < high ? least : high;
        }
        row[0] = row[1] = row[2];
        row[width + 2] = row[width + 3] = row[width + 1];
        for (ptrdiff_t x = 0; x < width; x++)
            across[y * width + x] = blurred(row[x], row[x + 1], row[x + 2], row[x + 3], row[x + 4]);
    }
    for (ptrdiff_t y = 0; y < height; y++) {
        const int16_t *rows[5];
        for (ptrdiff_t i = 0; i < 5; i++)
            rows[i] = across + lesser(greater(y + i - 2, 0), height - 1) * width;
        for (ptrdiff_t x = 0; x < width; x++)
            blur_of[y * width + x] = blurred(rows[0][x], rows[1][x], rows[2][x], rows[3][x], rows[4][x]);
    }
}

VECTORISED static void halve(const int16_t *restrict light, ptrdiff_t height, ptrdiff_t width, int16_t *restrict half)
{
    for (ptrdiff_t y = 0; y < height / 2; y++)
        for (ptrdiff_t x = 0; x < width / 2; x++) {
            const int16_t *four = light + 2 * (y * width + x);
            half[y * (width / 2) + x] = (int16_t)((four[0] + four[1] + four[width] + four[width + 1] + 2) >> 2);
        }
}

/* Variance of the difference where two pictures overlap after a shift by whole blocks. */
VECTORISED static double disagreement(const Pictures *at, ptrdiff_t across, ptrdiff_t down)
{
    const ptrdiff_t left = greater(across, 0), columns = at->width - labs(across), rows = at->height - labs(down);
    int64_t sum = 0, squares = 0;
    for (ptrdiff_t y = greater(down, 0); y < greater(down, 0) + rows; y++) {
        const int16_t *now = at->now + y * at->width + left, *before = at->before + (y - down) * at->width + left - across;
        int row = 0, row_squares = 0;
        for (ptrdiff_t x = 0; x < columns; x++) {
            const int16_t change = (int16_t)(now[x] - before[x]);
            row += change;
            row_squares += change * change;
        }
        sum += row;
        squares += row_squares;
    }
    const double count = (double)(rows * columns), mean = (double)sum / count;
    return (double)squares / count - mean * mean;
}

static Shift search(const Pictures *at)
{
    Shift best = {0.0, 0.0};
    double least = INFINITY;
    const ptrdiff_t most_down = lesser(REACH_DOWN, at->height / 2), most_across = lesser(REACH_ACROSS, at->width / 2);
    for (ptrdiff_t down = -most_down; down <= most_down; down++)
        for (ptrdiff_t across = -most_across; across <= most_across; across++) {
            const double farther = 1.0 + NEARER * sqrt((double)(across * across + down * down));
            const double badness = (disagreement(at, across, down) + NOISE) * farther;
            if (badness < least) {
                least = badness;
                best = (Shift){(double)across, (double)down};
            }
        }
    return best;
}

/* The equations of a tile, for its shift as a whole, around one by whole blocks. The light of both may differ. */
VECTORISED static Equations equations(const Pictures *at, int tile, ptrdiff_t across, ptrdiff_t down)
{
    const ptrdiff_t i = tile / TILES_ACROSS, j = tile % TILES_ACROSS, height = at->height, width = at->width;
    const ptrdiff_t top = greater(i * height / TILES_DOWN, 1 + greater(down, 0)),
                    bottom = lesser((i + 1) * height / TILES_DOWN, height - 1 + lesser(down, 0)),
                    left = greater(j * width / TILES_ACROSS, 1 + greater(across, 0)),
                    columns = lesser((j + 1) * width / TILES_ACROSS, width - 1 + lesser(across, 0)) - left;
    if (bottom - top < 2 || columns < 2)
        return (Equations){0};
    int64_t sums[8] = {0};
    for (ptrdiff_t y = top; y < bottom; y++) {
        const int16_t *now = at->now + y * width + left, *before = at->before + (y - down) * width + left - across;
        int32_t xx = 0, xy = 0, yy = 0, xe = 0, ye = 0, xs = 0, ys = 0, es = 0;
        for (ptrdiff_t k = 0; k < columns; k++) {
            const int16_t x = (int16_t)(now[k + 1] - now[k - 1] + before[k + 1] - before[k - 1]);
            const int16_t y4 = (int16_t)(now[k + width] - now[k - width] + before[k + width] - before[k - width]);
            const int16_t e = (int16_t)(before[k] - now[k]);
            xx += x * x, xy += x * y4, yy += y4 * y4, xe += x * e, ye += y4 * e, xs += x, ys += y4, es += e;
        }
        const int32_t row[8] = {xx, xy, yy, xe, ye, xs, ys, es};
        for (int k = 0; k < 8; k++)
            sums[k] += row[k];
    }
    const double n = (double)(columns * (bottom - top)), x = (double)sums[5], y = (double)sums[6], e = (double)sums[7];
    const double xx = ((double)sums[0] - x * x / n) / 16.0, xy = ((double)sums[1] - x * y / n) / 16.0,
                 yy = ((double)sums[2] - y * y / n) / 16.0; /* the gradients above are four times what they say */
    const double xe = ((double)sums[3] - x * e / n) / 4.0, ye = ((double)sums[4] - y * e / n) / 4.0;
    const double a = (double)across, d = (double)down;
    return (Equations){xx, xy, yy, xe + xx * a + xy * d, ye + xy * a + yy * d, n};
}

static Shift solved(Equations of)
{
    const double determinant = of.xx * of.yy - of.xy * of.xy;
    return (Shift){(of.yy * of.x - of.xy * of.y) / determinant, (of.xx * of.y - of.xy * of.x) / determinant};
}

/* `of`, drawn towards a shift by squared gradients. */
static Equations drawn(Equations of, double xx, double xy, double yy, Shift to)
{
    return (Equations){of.xx + xx, of.xy + xy, of.yy + yy, of.x + xx * to.x + xy * to.y, of.y + xy * to.x + yy * to.y,
                       of.count};
}

/* One step towards the shift of each tile; what a tile does not show it takes from the whole picture. */
static void step(const Pictures *at, Shift *whole, Shift tiles[TILES])
{
    Equations each[TILES], all = {0};
    for (int tile = 0; tile < TILES; tile++) {
        const Equations one = each[tile] = equations(at, tile, lrint(tiles[tile].x), lrint(tiles[tile].y));
        all = (Equations){all.xx + one.xx, all.xy + one.xy, all.yy + one.yy,
                          all.x + one.x,   all.y + one.y,   all.count + one.count};
    }
    const double least = LEAST_GRADIENT * fmax(all.count, 1.0), part = OF_THE_WHOLE / TILES, widest = (double)at->width,
                 highest = (double)at->height;
    *whole = solved(drawn(all, least, 0.0, least, *whole));
    for (int tile = 0; tile < TILES; tile++) {
        const Shift found = solved(drawn(each[tile], part * all.xx + least / TILES, part * all.xy,
                                         part * all.yy + least / TILES, *whole));
        tiles[tile] = (Shift){fmin(fmax(found.x, -widest), widest), fmin(fmax(found.y, -highest), highest)};
    }
}

static double median_length(const Shift tiles[TILES])
{
    double sorted[TILES];
    for (int tile = 0; tile < TILES; tile++) {
        const double length = sqrt(tiles[tile].x * tiles[tile].x + tiles[tile].y * tiles[tile].y);
        int place = tile;
        for (; place > 0 && sorted[place - 1] > length; place--)
            sorted[place] = sorted[place - 1];
        sorted[place] = length;
    }
    return (sorted[TILES / 2 - 1] + sorted[TILES / 2]) / 2.0;
}

static double followed(const Pictures sizes[SIZES])
{
    Shift whole = search(&sizes[SIZES - 1]), tiles[TILES];
    for (int tile = 0; tile < TILES; tile++)
        tiles[tile] = whole;
    for (int size = SIZES - 2; size >= 0; size--) {
        whole = (Shift){2.0 * whole.x, 2.0 * whole.y};
        for (int tile = 0; tile < TILES; tile++)
            tiles[tile] = (Shift){2.0 * tiles[tile].x, 2.0 * tiles[tile].y};
        for (int i = 0; i < steps_at[size]; i++)
            step(&sizes[size], &whole, tiles);
    }
    return median_length(tiles);
}

double median_shift(const int16_t *before, const int16_t *now, size_t height, size_t width, int16_t brightest)
{
    int16_t rise;
    if (!rise_of(before, now, height * width, brightest, &rise))
        return -1.0;
    const int16_t low = rise > 0 ? rise : 0, high = (int16_t)(brightest + (rise < 0 ? rise : 0));
    int16_t *room = malloc((2 * SIZES + 1) * height * width * sizeof *room), *next = room;
    if (!room)
        return NAN;
    Pictures sizes[SIZES];
    for (int size = 0; size < SIZES; size++) {
        const ptrdiff_t rows = (ptrdiff_t)height >> size, columns = (ptrdiff_t)width >> size;
        sizes[size] = (Pictures){next, next + rows * columns, rows, columns};
        next += 2 * rows * columns;
    }
    blur(before, sizes[0].height, sizes[0].width, rise, low, high, next, sizes[0].before);
    blur(now, sizes[0].height, sizes[0].width, 0, low, high, next, sizes[0].now);
    for (int size = 1; size < SIZES; size++) {
        const Pictures *from = &sizes[size - 1];
        halve(from->before, from->height, from->width, sizes[size].before);
        halve(from->now, from->height, from->width, sizes[size].now);
    }
    const double shift = followed(sizes);
    free(room);
    return shift;
}
