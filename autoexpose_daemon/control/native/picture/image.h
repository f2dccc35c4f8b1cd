/* A grey image of any layout in memory. */
#ifndef AUTOEXPOSE_IMAGE_H
#define AUTOEXPOSE_IMAGE_H

#include <stddef.h>
#include <stdint.h>

/* Pixel (y, x) lies at data[y * row_step + x * column_step]. */
typedef struct {
    const uint8_t *data;
    ptrdiff_t row_step, column_step;
    size_t height, width;
} Image;

static inline uint8_t at(const Image *image, size_t y, size_t x)
{
    return image->data[(ptrdiff_t)y * image->row_step + (ptrdiff_t)x * image->column_step];
}

/* A row without gaps: its own place, or `copy`, which has room for it. */
static inline const uint8_t *row_in(const Image *image, size_t y, uint8_t *copy)
{
    if (image->column_step == 1)
        return image->data + (ptrdiff_t)y * image->row_step;
    for (size_t x = 0; x < image->width; x++)
        copy[x] = at(image, y, x);
    return copy;
}

#endif
