#include "tones.h"

#include <string.h>

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

static int is_beside_saturated(const Image *image, size_t y, size_t x, const uint8_t *saturated)
{
    const size_t top = y ? y - 1 : 0, bottom = y + 1 < image->height ? y + 1 : y;
    const size_t left = x ? x - 1 : 0, right = x + 1 < image->width ? x + 1 : x;
    uint8_t brightest = 0;
    for (size_t row = top; row <= bottom; row++)
        for (size_t column = left; column <= right; column++)
            brightest = at(image, row, column) > brightest ? at(image, row, column) : brightest;
    return saturated[brightest];
}

void sample_greys(const Image *image, size_t stride, const uint8_t saturated[GREY_LEVELS], uint8_t *sampled)
{
    for (size_t y = 0; y < image->height; y += stride)
        for (size_t x = 0; x < image->width; x += stride)
            *sampled++ = is_beside_saturated(image, y, x, saturated) ? 255 : at(image, y, x);
}

Changes light_changes(const uint8_t *before, const uint8_t *now, const uint8_t *weights, size_t count,
                      const float log_exposure[GREY_LEVELS], const uint8_t clipped[GREY_LEVELS], float *values)
{
    Changes changes = {0, 0, 0, 0};
    float *end = values + 2 * count; /* bounds are first collected from there downwards */
    size_t bounds = 0;
    for (size_t i = 0; i < count; i++) {
        if (weights && !weights[i])
            continue;
        const float change = log_exposure[now[i]] - log_exposure[before[i]];
        const int rise = clipped[now[i]] - clipped[before[i]];
        changes.counted++;
        if (clipped[now[i]] == 1 && clipped[before[i]] == 1)
            values[changes.known++] = change;
        else if (rise) {
            *(end - ++bounds) = change;
            changes.at_least += rise > 0;
        }
    }
    changes.all = changes.known;
    if (changes.known == changes.counted)
        return changes;
    memmove(values + changes.known, end - bounds, bounds * sizeof *values);
    memcpy(values + changes.known + bounds, values, changes.known * sizeof *values);
    changes.all = 2 * changes.known + bounds;
    return changes;
}
