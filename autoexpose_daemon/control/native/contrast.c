#include "contrast.h"

#include <stdlib.h>
#include <string.h>

static inline int at(const Image *image, size_t y, size_t x)
{
    return image->data[(ptrdiff_t)y * image->row_step + (ptrdiff_t)x * image->column_step];
}

static inline uint8_t greater(uint8_t a, uint8_t b)
{
    return a > b ? a : b;
}

/* Gradient energy and brightest neighbour of the pixels 1 to width - 2 of a row; plain, so that compilers vectorise it. */
static void row_of(const uint8_t *restrict above, const uint8_t *restrict here, const uint8_t *restrict below,
                   size_t width, int32_t *restrict energy, uint8_t *restrict brightest)
{
    for (size_t x = 1; x + 1 < width; x++) {
        const int32_t across = here[x + 1] - here[x - 1], down = below[x] - above[x];
        energy[x] = across * across + down * down;
        brightest[x] = greater(greater(greater(above[x], below[x]), greater(here[x - 1], here[x + 1])), here[x]);
    }
}

static const uint8_t *row_in(const Image *image, size_t y, uint8_t *copy)
{
    if (image->column_step == 1)
        return image->data + (ptrdiff_t)y * image->row_step;
    for (size_t x = 0; x < image->width; x++)
        copy[x] = (uint8_t)at(image, y, x);
    return copy;
}

int contrast_sums(const Image *image, const Image *region, int64_t *energy, int64_t *count)
{
    const size_t width = image->width, rows = image->height - 2, columns = width - 2;
    uint8_t *bytes = malloc(4 * width);
    int32_t *energies = malloc(width * sizeof *energies);
    if (!bytes || !energies) {
        free(bytes);
        free(energies);
        return -1;
    }
    memset(energy, 0, CELLS * CELLS * GREY_LEVELS * sizeof *energy);
    memset(count, 0, CELLS * CELLS * GREY_LEVELS * sizeof *count);
    for (size_t y = 0; y < rows; y++) {
        row_of(row_in(image, y, bytes), row_in(image, y + 1, bytes + width), row_in(image, y + 2, bytes + 2 * width),
               width, energies, bytes + 3 * width);
        const uint8_t *brightest = bytes + 3 * width;
        size_t x = 0;
        for (size_t cell = 0; cell < CELLS; cell++) {
            const size_t place = (y * CELLS / rows * CELLS + cell) * GREY_LEVELS;
            const size_t end = ((cell + 1) * columns + CELLS - 1) / CELLS; /* first x with x * CELLS / columns > cell */
            for (; x < end; x++) {
                const int weight = region ? at(region, y + 1, x + 1) : 1;
                energy[place + brightest[x + 1]] += (int64_t)weight * energies[x + 1];
                count[place + brightest[x + 1]] += weight;
            }
        }
    }
    free(bytes);
    free(energies);
    return 0;
}
