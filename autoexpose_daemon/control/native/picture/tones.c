#include "tones.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "vectorised.h"

/* Neighbours are often equal, and an addition to what has just been stored is slow: tables take turns. */
enum { TURNS = 4 };

static void count_row(const uint8_t *row, size_t width, uint32_t tables[TURNS][GREY_LEVELS])
{
    size_t x = 0;
    for (; x + 8 <= width; x += 8) {
        uint64_t eight;
        memcpy(&eight, row + x, sizeof eight);
        for (int byte = 0; byte < 8; byte++)
            tables[byte % TURNS][eight >> 8 * byte & 255]++;
    }
    for (; x < width; x++)
        tables[0][row[x]]++;
}

void grey_counts(const Image *image, const Image *region, double counts[GREY_LEVELS])
{
    uint32_t tables[TURNS][GREY_LEVELS];
    memset(tables, 0, sizeof tables);
    for (size_t y = 0; y < image->height; y++)
        if (!region && image->column_step == 1)
            count_row(image->data + (ptrdiff_t)y * image->row_step, image->width, tables);
        else
            for (size_t x = 0; x < image->width; x++)
                tables[x % TURNS][at(image, y, x)] += !region || at(region, y, x);
    for (size_t grey = 0; grey < GREY_LEVELS; grey++)
        counts[grey] = (double)tables[0][grey] + tables[1][grey] + tables[2][grey] + tables[3][grey];
}

/* In bytes, which compilers vectorise, as long as they cannot overflow. */
VECTORISED static size_t count_in_row(const uint8_t *row, size_t width, uint8_t grey)
{
    enum { LANES_AT_ONCE = 32 };
    size_t found = 0, x = 0;
    while (width - x >= LANES_AT_ONCE) {
        uint8_t lanes[LANES_AT_ONCE] = {0};
        for (int turn = 0; turn < 255 && width - x >= LANES_AT_ONCE; turn++, x += LANES_AT_ONCE)
            for (size_t i = 0; i < LANES_AT_ONCE; i++)
                lanes[i] += row[x + i] <= grey;
        for (size_t i = 0; i < LANES_AT_ONCE; i++)
            found += lanes[i];
    }
    for (; x < width; x++)
        found += row[x] <= grey;
    return found;
}

size_t count_at_most(const Image *image, int grey)
{
    const int gapless = image->column_step == 1 && image->row_step == (ptrdiff_t)image->width;
    const size_t rows = gapless ? 1 : image->height, width = gapless ? image->width * image->height : image->width;
    size_t found = 0;
    for (size_t y = 0; grey >= 0 && y < rows; y++)
        if (image->column_step == 1)
            found += count_in_row(image->data + (ptrdiff_t)y * image->row_step, width, (uint8_t)(grey < 255 ? grey : 255));
        else
            for (size_t x = 0; x < width; x++)
                found += at(image, y, x) <= grey;
    return found;
}

/* The greatest of each column of three rows. */
VECTORISED static void greatest_of(const uint8_t *above, const uint8_t *here, const uint8_t *below, size_t width,
                                   uint8_t *restrict greatest)
{
    for (size_t x = 0; x < width; x++) {
        const uint8_t ends = above[x] > below[x] ? above[x] : below[x];
        greatest[x] = ends > here[x] ? ends : here[x];
    }
}

int sample_greys(const Image *image, size_t stride, const uint8_t saturated[GREY_LEVELS], uint8_t *sampled)
{
    const size_t width = image->width, last = image->height - 1;
    uint8_t *rows = malloc(4 * width);
    if (!rows)
        return -1;
    uint8_t *greatest = rows + 3 * width;
    for (size_t y = 0; y <= last; y += stride) {
        const uint8_t *here = row_in(image, y, rows + width);
        greatest_of(row_in(image, y ? y - 1 : 0, rows), here, row_in(image, y < last ? y + 1 : last, rows + 2 * width),
                    width, greatest);
        for (size_t x = 0; x < width; x += stride) {
            const uint8_t left = greatest[x ? x - 1 : 0], right = greatest[x + 1 < width ? x + 1 : x];
            const uint8_t beside = left > right ? left : right;
            *sampled++ = saturated[beside > greatest[x] ? beside : greatest[x]] ? 255 : here[x];
        }
    }
    free(rows);
    return 0;
}

/* Unsigned integers in the order of the numbers. */
static inline uint32_t key_of(float value)
{
    uint32_t bits;
    memcpy(&bits, &value, sizeof bits);
    return bits >> 31 ? ~bits : bits | UINT32_C(1) << 31;
}

/* The value of a rank, from 0: counts by the first bits of the keys, and again by the next ones of those left. */
static float ranked(float *values, size_t count, size_t rank)
{
    enum { BITS = 11, PLACES = 1 << BITS };
    for (int shift = 32 - BITS; count > 1 && shift > -BITS; shift -= BITS) {
        size_t counts[PLACES] = {0}, place = 0, kept = 0;
        const int right = shift > 0 ? shift : 0;
        for (size_t i = 0; i < count; i++)
            counts[key_of(values[i]) >> right & (PLACES - 1)]++;
        for (; rank >= counts[place]; place++)
            rank -= counts[place];
        for (size_t i = 0; i < count; i++)
            if ((key_of(values[i]) >> right & (PLACES - 1)) == place)
                values[kept++] = values[i];
        count = kept;
    }
    return values[0];
}

int light_change(const uint8_t *before, const uint8_t *now, const uint8_t *weights, size_t count,
                 const float log_exposure[GREY_LEVELS], const uint8_t clipped[GREY_LEVELS], Change *change)
{
    float *values = malloc((2 * count + 1) * sizeof *values); /* known ones, and from the end downwards bounds */
    size_t bounds = 0, at_least = 0;
    *change = (Change){0, 0, NAN};
    if (!values)
        return -1;
    float *end = values + 2 * count;
    for (size_t i = 0; i < count; i++) {
        if (weights && !weights[i])
            continue;
        const uint8_t first = clipped[before[i]], second = clipped[now[i]];
        const float rise = log_exposure[now[i]] - log_exposure[before[i]];
        change->counted++;
        if (first == 1 && second == 1)
            values[change->known++] = rise;
        else if (first != second) {
            *(end - ++bounds) = rise;
            at_least += second > first;
        }
    }
    const size_t known = change->known;
    if (known == change->counted && known)
        change->median = ranked(values, known, known / 2);
    else if (known + bounds) { /* each known change counts twice: as a bound from below, and from above */
        const size_t all = 2 * known + bounds, rank = known + at_least;
        memmove(values + known, end - bounds, bounds * sizeof *values);
        memcpy(values + known + bounds, values, known * sizeof *values);
        change->median = ranked(values, all, rank < all ? rank : all - 1);
    }
    free(values);
    return 0;
}
