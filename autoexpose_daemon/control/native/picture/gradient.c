#include "gradient.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#if defined(__x86_64__)
#include <immintrin.h>
#elif defined(__aarch64__)
#include <arm_neon.h>
#endif

enum { BLOCK = 64 }; /* bytes processed at once */

/* Three rows, each `bytes` long, with their mirrored neighbours before and after, and room for the derivatives of the
 * middle one. The rows are readable from one block before to one block after their own blocks; the derivatives start
 * one block before the row, and are as long. */
typedef struct {
    const uint8_t *above, *here, *below;
    int16_t *sum, *difference;
    size_t bytes;
    ptrdiff_t step;
} Rows;

typedef struct {
    uint8_t table[GREY_LEVELS]; /* weight of each magnitude */
    int least;                  /* smallest magnitude with a weight */
} Weights;

/* Replaces the magnitudes of a block by their weights; likewise information_avx2 and so on. */
static inline void information_scalar(const Weights *weights, uint8_t *block)
{
    for (int i = 0; i < BLOCK; i++)
        block[i] = weights->table[block[i]];
}

#define TARGET
#define NAME(x) x##_portable
#define INFORMATION information_scalar
#include "gradient_kernel.h"
#undef TARGET
#undef NAME
#undef INFORMATION

#if defined(__x86_64__)

/* A shuffle looks up one sixteenth of the table, and gives 0 where the index is negative. With the index
 * lowered by 16 each time, the sixteenths up to the right one respond; their entries are differences, to be summed. */
__attribute__((target("avx2"))) static inline void information_avx2(const Weights *weights, uint8_t *block)
{
    const __m256i step = _mm256_set1_epi8(16), half = _mm256_set1_epi8((char)128);
    for (int i = 0; i < BLOCK; i += 32) {
        const __m256i m = _mm256_loadu_si256((const __m256i *)(block + i));
        __m256i found = _mm256_setzero_si256();
        for (int upper = 0; upper < 2; upper++) {
            __m256i index = upper ? _mm256_xor_si256(m, half) : m;
            __m128i before = _mm_setzero_si128();
            for (int part = 8 * upper; part < 8 * upper + 8; part++) {
                const __m128i here = _mm_loadu_si128((const __m128i *)(weights->table + 16 * part));
                const __m256i change = _mm256_broadcastsi128_si256(_mm_xor_si128(here, before));
                found = _mm256_xor_si256(found, _mm256_shuffle_epi8(change, index));
                index = _mm256_subs_epi8(index, step);
                before = here;
            }
        }
        _mm256_storeu_si256((__m256i *)(block + i), found);
    }
}

#define TARGET __attribute__((target("avx2,fma")))
#define NAME(x) x##_avx2
#define INFORMATION information_avx2
#include "gradient_kernel.h"
#undef TARGET
#undef NAME
#undef INFORMATION

/* Two shuffles of 128 entries each hold the whole table; the top bit of the magnitude chooses. */
#define AVX512 "avx512f,avx512bw,avx512vl,avx512dq,avx512vbmi"
#if defined(__clang__)
#define TARGET __attribute__((target(AVX512)))
#else
#define TARGET __attribute__((target(AVX512 ",prefer-vector-width=512")))
#endif
TARGET static inline void information_avx512(const Weights *weights, uint8_t *block)
{
    const __m512i *table = (const __m512i *)weights->table;
    const __m512i m = _mm512_loadu_si512(block);
    const __m512i lower = _mm512_permutex2var_epi8(_mm512_loadu_si512(table), m, _mm512_loadu_si512(table + 1));
    const __m512i upper = _mm512_permutex2var_epi8(_mm512_loadu_si512(table + 2), m, _mm512_loadu_si512(table + 3));
    _mm512_storeu_si512(block, _mm512_mask_blend_epi8(_mm512_movepi8_mask(m), lower, upper));
}

#define NAME(x) x##_avx512
#define INFORMATION information_avx512
#include "gradient_kernel.h"
#undef TARGET
#undef NAME
#undef INFORMATION

#elif defined(__aarch64__)

/* A look-up of 64 entries ignores indices beyond them; so four of them, with the index lowered by 64 each time. */
static inline void information_neon(const Weights *weights, uint8_t *block)
{
    for (int i = 0; i < BLOCK; i += 16) {
        uint8x16_t index = vld1q_u8(block + i), found = vdupq_n_u8(0);
        for (int part = 0; part < 4; part++) {
            found = vqtbx4q_u8(found, vld1q_u8_x4(weights->table + 64 * part), index);
            index = vsubq_u8(index, vdupq_n_u8(64));
        }
        vst1q_u8(block + i, found);
    }
}

#define TARGET
#define NAME(x) x##_neon
#define INFORMATION information_neon
#include "gradient_kernel.h"
#undef TARGET
#undef NAME
#undef INFORMATION
#endif

/* One row through the tables, into row[0 .. bytes), with the mirrored neighbour on either side. */
static void look_up_row(const Image *image, size_t y, const uint8_t *words, uint8_t *row)
{
    const uint8_t *pixel = image->data + (ptrdiff_t)y * image->row_step;
    const size_t width = image->width, step = words ? LANES : 1;
    if (words)
        for (size_t x = 0; x < width; x++, pixel += image->column_step)
            memcpy(row + LANES * x, words + LANES * *pixel, LANES);
    else if (image->column_step == 1)
        memcpy(row, pixel, width);
    else
        for (size_t x = 0; x < width; x++, pixel += image->column_step)
            row[x] = *pixel;
    memcpy(row - step, row + step, step);
    memcpy(row + width * step, row + (width - 2) * step, step);
}

/* One row of weights, each repeated for every byte of its pixel. */
static void spread_region_row(const Image *region, size_t y, size_t step, uint8_t *row)
{
    const uint8_t *pixel = region->data + (ptrdiff_t)y * region->row_step;
    for (size_t x = 0; x < region->width; x++, pixel += region->column_step) {
        const uint64_t everywhere = *pixel * UINT64_C(0x0101010101010101);
        memcpy(row + step * x, &everywhere, LANES);
    }
}

typedef void AddRow(const Rows *rows, const uint8_t *region, const Weights *weights, uint64_t *totals);

static inline int sum_image(AddRow *add_row, const Image *image, const Image *region, const uint8_t *words,
                            const uint8_t *weight_table, uint64_t sums[LANES])
{
    const size_t step = words ? LANES : 1, bytes = step * image->width;
    /* Everything starts at a multiple of BLOCK: vector loads across cache lines cost double. */
    const size_t padded = BLOCK + (bytes + BLOCK - 1) / BLOCK * BLOCK + BLOCK;
    const size_t size = 4 * padded + 2 * padded * sizeof(int16_t);
    uint8_t *buffer = aligned_alloc(BLOCK, size), *rows[3], *region_row = NULL;
    int16_t *derivatives = (int16_t *)(buffer + 4 * padded);
    uint64_t totals[BLOCK] = {0};
    Weights weights = {.least = 0};
    if (!buffer)
        return -1;
    memset(buffer, 0, size);
    memcpy(weights.table, weight_table, GREY_LEVELS);
    while (weights.least < GREY_LEVELS && !weights.table[weights.least])
        weights.least++;
    for (int i = 0; i < 3; i++)
        rows[i] = buffer + (size_t)i * padded + BLOCK;

    look_up_row(image, 0, words, rows[0]);
    for (size_t y = 0; y < image->height; y++) {
        uint8_t *here = rows[y % 3], *below = rows[(y + 1) % 3], *above = rows[(y + 2) % 3];
        if (y + 1 < image->height)
            look_up_row(image, y + 1, words, below);
        if (region) {
            region_row = buffer + 3 * padded + BLOCK;
            spread_region_row(region, y, step, region_row);
        }
        add_row(&(Rows){.above = y ? above : below,
                        .here = here,
                        .below = y + 1 < image->height ? below : above,
                        .sum = derivatives,
                        .difference = derivatives + padded,
                        .bytes = bytes,
                        .step = (ptrdiff_t)step},
                region_row, &weights, totals);
    }
    free(buffer);

    memset(sums, 0, LANES * sizeof *sums);
    for (int i = 0; i < BLOCK; i++)
        sums[words ? i % LANES : 0] += totals[i];
    return 0;
}

#define WAY(suffix)                                                                                                    \
    static int sums_##suffix(const Image *image, const Image *region, const uint8_t *words, const uint8_t *weights,   \
                             uint64_t sums[LANES])                                                                     \
    {                                                                                                                  \
        return sum_image(add_row_##suffix, image, region, words, weights, sums);                                       \
    }

WAY(portable)
#if defined(__x86_64__)
WAY(avx2)
WAY(avx512)
#elif defined(__aarch64__)
WAY(neon)
#endif

const InstructionSet *instruction_sets(void)
{
    static InstructionSet sets[4];
    int count = 0;
    if (sets[0].name)
        return sets;
#if defined(__x86_64__)
    __builtin_cpu_init();
    if (__builtin_cpu_supports("avx512vbmi") && __builtin_cpu_supports("avx512bw") &&
        __builtin_cpu_supports("avx512vl") && __builtin_cpu_supports("avx512dq"))
        sets[count++] = (InstructionSet){"avx512vbmi", sums_avx512};
    if (__builtin_cpu_supports("avx2") && __builtin_cpu_supports("fma"))
        sets[count++] = (InstructionSet){"avx2", sums_avx2};
#elif defined(__aarch64__)
    sets[count++] = (InstructionSet){"neon", sums_neon};
#endif
    sets[count++] = (InstructionSet){"portable", sums_portable};
    return sets;
}
