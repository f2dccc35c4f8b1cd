#include "contrast.h"

#include <stdlib.h>
#include <string.h>

#include "vectorised.h"

/* A place of a table holds energy and count in one word, so that a pixel costs one addition. Between two `add_up`, a
 * place gets at most MOST_PIXELS, each of an energy up to 2 * 255 * 255 and a weight up to 255. */
enum { ENERGY_BITS = 40, MOST_PIXELS = 32768 };

/* Neighbours often fall on the same place, and an addition to what has just been stored is slow: they take turns. */
enum { TURNS = 4 };

static inline uint8_t greater(uint8_t a, uint8_t b)
{
    return a > b ? a : b;
}

static inline uint8_t lesser(uint8_t a, uint8_t b)
{
    return a < b ? a : b;
}

static inline uint8_t above_by(uint8_t a, uint8_t b)
{
    return (uint8_t)(greater(a, b) - b);
}

static inline uint16_t difference(uint8_t a, uint8_t b)
{
    return (uint16_t)(greater(a, b) - lesser(a, b));
}

/* Arithmetic, since looking bins up in a table would take longer than the rest of a row. */
static inline uint8_t unsaturated_bin(uint8_t grey, uint8_t black)
{
    const uint8_t signal = above_by(grey, black);
    const uint8_t ones = lesser(signal, 16), twos = lesser(above_by(signal, 16), 32),
                  fours = lesser(above_by(signal, 48), 64), eights = above_by(signal, 112);
    return (uint8_t)(ones + (twos >> 1) + (fours >> 2) + (eights >> 3));
}

static inline uint8_t bin_of(uint8_t grey, GreyBins bins)
{
    return grey >= bins.saturated ? bins.last : unsaturated_bin(grey, bins.black);
}

int grey_bin(int grey, int black)
{
    return unsaturated_bin((uint8_t)grey, (uint8_t)black);
}

/* Gradient energy, and bin of the brightest neighbour, of `count` pixels that begin here in three rows. */
static inline void block_of(const uint8_t *restrict above, const uint8_t *restrict here, const uint8_t *restrict below,
                            size_t count, GreyBins bins, uint32_t *restrict energy, uint8_t *restrict bin)
{
    const uint8_t *left = here - 1, *right = here + 1;
    for (size_t x = 0; x < count; x++) {
        const uint16_t across = difference(right[x], left[x]), down = difference(below[x], above[x]);
        energy[x] = (uint32_t)(uint16_t)(across * across) + (uint16_t)(down * down); /* 255 * 255 fits 16 bits */
    }
    for (size_t x = 0; x < count; x++)
        bin[x] = bin_of(greater(greater(greater(above[x], below[x]), greater(left[x], right[x])), here[x]), bins);
}

/* The same of the pixels 1 to width - 2 of a row, in blocks of one length, the last of which may overlap the one before:
 * compilers make no loops for odd ends of those. */
VECTORISED static void row_of(const uint8_t *above, const uint8_t *here, const uint8_t *below, size_t width,
                              GreyBins bins, uint32_t *energy, uint8_t *bin)
{
    enum { BLOCK = 32 };
    const size_t end = width - 1;
    if (end <= BLOCK) {
        block_of(above + 1, here + 1, below + 1, end - 1, bins, energy + 1, bin + 1);
        return;
    }
    for (size_t x = 1; x < end; x += BLOCK) {
        const size_t at = x < end - BLOCK ? x : end - BLOCK;
        block_of(above + at, here + at, below + at, BLOCK, bins, energy + at, bin + at);
    }
}

/* Adds the tables of a row of cells to its sums, and clears them. */
static void add_up(uint64_t *restrict tables, size_t places, double *restrict energy, double *restrict count)
{
    for (size_t place = 0; place < places; place++) {
        uint64_t energies = 0, counts = 0;
        for (size_t turn = 0; turn < TURNS; turn++) {
            const uint64_t sums = tables[turn * places + place];
            energies += sums & (((uint64_t)1 << ENERGY_BITS) - 1);
            counts += sums >> ENERGY_BITS;
        }
        energy[place] += (double)energies;
        count[place] += (double)counts;
    }
    memset(tables, 0, TURNS * places * sizeof *tables);
}

int contrast_sums(const Image *image, const Image *region, GreyBins bins, double *energy, double *count)
{
    const size_t width = image->width, rows = image->height - 2, columns = width - 2;
    const uint64_t one = (uint64_t)1 << ENERGY_BITS;
    uint8_t *bytes = malloc(4 * width);
    uint32_t *energies = malloc(width * sizeof *energies);
    const size_t each = (size_t)bins.last + 1;
    const size_t places = CELLS * each;
    uint64_t *tables = calloc(TURNS * places, sizeof *tables);
    const int failed = !bytes || !energies || !tables;
    memset(energy, 0, CELLS * places * sizeof *energy);
    memset(count, 0, CELLS * places * sizeof *count);
    size_t pixels = 0; /* at most, in one place of the tables */
    for (size_t y = 0; !failed && y < rows; y++) {
        row_of(row_in(image, y, bytes), row_in(image, y + 1, bytes + width), row_in(image, y + 2, bytes + 2 * width),
               width, bins, energies, bytes + 3 * width);
        const uint8_t *bin = bytes + 3 * width;
        size_t x = 0;
        for (size_t cell = 0; cell < CELLS; cell++) {
            const size_t end = ((cell + 1) * columns + CELLS - 1) / CELLS; /* first x with x * CELLS / columns > cell */
            uint64_t *table = tables + cell * each;
            if (!region)
                for (; x + TURNS <= end; x += TURNS)
                    for (size_t turn = 0; turn < TURNS; turn++)
                        table[turn * places + bin[x + turn + 1]] += one + energies[x + turn + 1];
            for (; x < end; x++)
                table[x % TURNS * places + bin[x + 1]] +=
                    (region ? (uint64_t)at(region, y + 1, x + 1) : 1) * (one + energies[x + 1]);
        }
        const size_t band = y * CELLS / rows, in_a_row = columns / CELLS / TURNS + 2;
        pixels += in_a_row;
        if (pixels + in_a_row > MOST_PIXELS || (y + 1) * CELLS / rows > band) {
            add_up(tables, places, energy + band * places, count + band * places);
            pixels = 0;
        }
    }
    free(bytes);
    free(energies);
    free(tables);
    return failed ? -1 : 0;
}
