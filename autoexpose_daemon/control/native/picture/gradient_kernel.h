/* The pass over an image, compiled once per instruction set by gradient.c, which defines TARGET (attributes),
 * NAME(x) (x with the set's suffix) and INFORMATION (weights of a block of magnitudes).
 *
 * A row is a row of bytes whose neighbours lie `step` bytes apart: 1 for an image as it is, 8 for eight predictions
 * interleaved. It is processed in blocks that the compiler turns into vector instructions. */

/* Across the rows, for `count` bytes: sums 1 2 1 and differences -1 0 1. */
TARGET static inline void NAME(derive_down)(const uint8_t *restrict above, const uint8_t *restrict here,
                                            const uint8_t *restrict below, size_t count, int16_t *restrict sum,
                                            int16_t *restrict difference)
{
    for (size_t i = 0; i < count; i++) {
        sum[i] = (int16_t)(above[i] + 2 * here[i] + below[i]);
        difference[i] = (int16_t)(below[i] - above[i]);
    }
}

/* Along the row: Sobel derivatives of a block. Returns a bound of its magnitudes, the greatest |dx| + |dy|. */
TARGET static inline int NAME(derive_along)(const int16_t *sum, const int16_t *difference, ptrdiff_t step,
                                            int16_t *restrict dx, int16_t *restrict dy)
{
    int16_t greatest = 0;
    for (int i = 0; i < BLOCK; i++) {
        const int16_t x = (int16_t)(sum[i + step] - sum[i - step]);
        const int16_t y = (int16_t)(difference[i - step] + 2 * difference[i] + difference[i + step]);
        const int16_t bound = (int16_t)((x < 0 ? -x : x) + (y < 0 ? -y : y));
        dx[i] = x;
        dy[i] = y;
        greatest = bound > greatest ? bound : greatest;
    }
    return greatest;
}

/* min(255, round(sqrt(dx^2 + dy^2))). Exact: the squares fit a float, and no root is nearer than 0.0004 to a half. */
TARGET static inline void NAME(magnitudes)(const int16_t *restrict dx, const int16_t *restrict dy,
                                           uint8_t *restrict magnitude)
{
    for (int i = 0; i < BLOCK; i++) {
        const float x = dx[i], y = dy[i];
        const int32_t rounded = (int32_t)(sqrtf(x * x + y * y) + 0.5f);
        magnitude[i] = (uint8_t)(rounded < 255 ? rounded : 255);
    }
}

TARGET static void NAME(add_row)(const Rows *rows, const uint8_t *region, const Weights *weights,
                                 uint64_t *restrict totals)
{
    int16_t *sum = rows->sum, *difference = rows->difference;
    uint32_t sums[BLOCK] = {0};
    /* From one block before, for aligned loads, to one pixel after. */
    NAME(derive_down)(rows->above - BLOCK, rows->here - BLOCK, rows->below - BLOCK, rows->bytes + BLOCK + LANES, sum,
                      difference);
    sum += BLOCK;
    difference += BLOCK;
    for (size_t start = 0; start < rows->bytes; start += BLOCK) {
        int16_t dx[BLOCK], dy[BLOCK];
        uint8_t information[BLOCK];
        if (NAME(derive_along)(sum + start, difference + start, rows->step, dx, dy) < weights->least)
            continue;
        NAME(magnitudes)(dx, dy, information);
        INFORMATION(weights, information);
        if (rows->bytes - start < BLOCK)
            memset(information + (rows->bytes - start), 0, BLOCK - (rows->bytes - start));
        if (region)
            for (int i = 0; i < BLOCK; i++)
                sums[i] += (uint32_t)information[i] * region[start + i];
        else
            for (int i = 0; i < BLOCK; i++)
                sums[i] += information[i];
    }
    for (int i = 0; i < BLOCK; i++)
        totals[i] += sums[i];
}
