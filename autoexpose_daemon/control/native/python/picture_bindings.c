/* contrast.h, shift.h and tones.h for Python. */
#include "arguments.h"
#include "bindings.h"
#include "picture/contrast.h"
#include "picture/shift.h"
#include "picture/tones.h"
#include <math.h>

PyDoc_STRVAR(contrast_sums_doc,
             "contrast_sums(image, black, saturated, energy, count, region=None)\n--\n\n"
             "Collect the gradients of `image` by cell and bin of the brightest grey level into `energy` and `count`.\n\n"
             "image: uint8 (height, width), at least 3x3. black, saturated: the greatest grey level that is black, and the\n"
             "least that is saturated. energy, count: float64 (64, n), written, with n bins: see GreyBins. region: uint8\n"
             "(height, width), what each pixel counts.");

static int check_bins(int black, int saturated, Py_ssize_t places)
{
    if (black < 0 || black >= saturated || saturated >= GREY_LEVELS)
        PyErr_SetString(PyExc_ValueError, "black must be at least 0, and below saturated, which is at most 255");
    else if (places != ALL_CELLS * (grey_bin(saturated - 1, black) + 2))
        PyErr_Format(PyExc_ValueError, "energy and count must have 64 rows, and a column for each of the %d bins",
                     grey_bin(saturated - 1, black) + 2);
    else
        return 0;
    return -1;
}

static PyObject *contrast_into(Held *held, PyObject *const objects[4], int black, int saturated)
{
    const Py_buffer *inside, *weights = NULL;
    double *energy, *count;
    if (!(inside = hold_bytes(held, objects[0], 2, PyBUF_STRIDES, "image")) ||
        (objects[3] != Py_None && !(weights = hold_bytes(held, objects[3], 2, PyBUF_STRIDES, "region"))) ||
        check_region(inside, weights) || !(energy = hold_result(held, objects[1], -1, "energy")) ||
        check_bins(black, saturated, held_numbers(held)) ||
        !(count = hold_result(held, objects[2], held_numbers(held), "count")))
        return NULL;
    if (inside->shape[0] < 3 || inside->shape[1] < 3 || inside->shape[1] > WIDEST)
        return PyErr_Format(PyExc_ValueError, "an image of %zdx%zd pixels has no inside: at least 3x3, at most %d wide",
                            inside->shape[1], inside->shape[0], (int)WIDEST);
    const Image image = image_of(inside), region = weights ? image_of(weights) : (Image){0};
    const GreyBins bins = {(uint8_t)black, (uint8_t)saturated, (uint8_t)(grey_bin(saturated - 1, black) + 1)};
    int failed;
    Py_BEGIN_ALLOW_THREADS
    failed = contrast_sums(&image, weights ? &region : NULL, bins, energy, count);
    Py_END_ALLOW_THREADS
    if (failed)
        return PyErr_NoMemory();
    Py_RETURN_NONE;
}

static PyObject *contrast_sums_of(PyObject *module, PyObject *arguments)
{
    PyObject *objects[4] = {NULL, NULL, NULL, Py_None};
    int black, saturated;
    Held held = {0};
    (void)module;
    if (!PyArg_ParseTuple(arguments, "OiiOO|O", &objects[0], &black, &saturated, &objects[1], &objects[2], &objects[3]))
        return NULL;
    PyObject *result = contrast_into(&held, objects, black, saturated);
    release(&held);
    return result;
}

PyDoc_STRVAR(grey_counts_doc, "grey_counts(image, region, counts)\n--\n\n"
                              "How many pixels have each grey level.\n\n"
                              "image: uint8 (height, width). region: the same; pixels of weight 0 are left out. None: all\n"
                              "count. counts: float64 (256,), written.");

static PyObject *grey_counts_of(PyObject *module, PyObject *arguments)
{
    PyObject *objects[3], *result = NULL;
    const Py_buffer *image, *region = NULL;
    double *counts;
    Held held = {0};
    (void)module;
    if (!PyArg_ParseTuple(arguments, "OOO", &objects[0], &objects[1], &objects[2]))
        return NULL;
    if ((image = hold_bytes(&held, objects[0], 2, PyBUF_STRIDES, "image")) &&
        (objects[1] == Py_None || (region = hold_bytes(&held, objects[1], 2, PyBUF_STRIDES, "region"))) &&
        !check_region(image, region) && (counts = hold_result(&held, objects[2], GREY_LEVELS, "counts"))) {
        const Image pixels = image_of(image), weights = region ? image_of(region) : (Image){0};
        grey_counts(&pixels, region ? &weights : NULL, counts);
        result = Py_NewRef(Py_None);
    }
    release(&held);
    return result;
}

PyDoc_STRVAR(count_at_most_doc, "count_at_most(image, grey)\n--\n\n"
                                "How many pixels of uint8 (height, width) have at most this grey level.");

static PyObject *count_at_most_of(PyObject *module, PyObject *arguments)
{
    PyObject *object, *result = NULL;
    int grey;
    Held held = {0};
    (void)module;
    if (!PyArg_ParseTuple(arguments, "Oi", &object, &grey))
        return NULL;
    const Py_buffer *view = hold_bytes(&held, object, 2, PyBUF_STRIDES, "image");
    if (view) {
        const Image image = image_of(view);
        result = PyLong_FromSize_t(count_at_most(&image, grey));
    }
    release(&held);
    return result;
}

PyDoc_STRVAR(sample_greys_doc, "sample_greys(image, stride, saturated, sampled)\n--\n\n"
                               "Every `stride`-th pixel; 255 where it or one around it is saturated.\n\n"
                               "image: uint8 (height, width). saturated: uint8 (256,), not 0 for saturated grey levels.\n"
                               "sampled: uint8, written, of the shape of image[::stride, ::stride].");

static int are_samples(const Py_buffer *image, const Py_buffer *sampled, Py_ssize_t stride)
{
    return image->len && stride > 0 && sampled->shape[0] == (image->shape[0] - 1) / stride + 1 &&
           sampled->shape[1] == (image->shape[1] - 1) / stride + 1;
}

static PyObject *samples_into(Held *held, PyObject *const objects[3], Py_ssize_t stride)
{
    const Py_buffer *image, *saturated, *sampled;
    if (!(image = hold_bytes(held, objects[0], 2, PyBUF_STRIDES, "image")) ||
        !(saturated = hold_bytes(held, objects[1], 1, PyBUF_ND, "saturated")) ||
        !(sampled = hold_bytes(held, objects[2], 2, PyBUF_ND | PyBUF_WRITABLE, "sampled")))
        return NULL;
    if (!are_samples(image, sampled, stride) || saturated->len != GREY_LEVELS)
        return PyErr_Format(PyExc_ValueError,
                            "sampled must have the shape of image[::stride, ::stride], not empty, and saturated 256");
    if (image->shape[1] > WIDEST)
        return PyErr_Format(PyExc_ValueError, "an image of %zdx%zd pixels cannot be sampled: at most %d wide",
                            image->shape[1], image->shape[0], (int)WIDEST);
    const Image pixels = image_of(image);
    if (sample_greys(&pixels, (size_t)stride, saturated->buf, sampled->buf))
        return PyErr_NoMemory();
    Py_RETURN_NONE;
}

static PyObject *sample_greys_of(PyObject *module, PyObject *arguments)
{
    PyObject *objects[3];
    Py_ssize_t stride;
    Held held = {0};
    (void)module;
    if (!PyArg_ParseTuple(arguments, "OnOO", &objects[0], &stride, &objects[1], &objects[2]))
        return NULL;
    PyObject *result = samples_into(&held, objects, stride);
    release(&held);
    return result;
}

PyDoc_STRVAR(light_change_doc,
             "light_change(before, now, weights, log_exposure, clipped)\n--\n\n"
             "The change of log exposure from one sample of pixels to the next: (counted, known, median).\n\n"
             "before, now, weights: uint8 (height, width); pixels of weight 0 are left out, None: all count.\n"
             "log_exposure: float32 (256,). clipped: uint8 (256,), 0 below, 2 above, 1 between. counted, known: pixels that\n"
             "count, and those of them clipped in neither sample. median: with those clipped in one as bounds; NaN: none.");

static PyObject *change_of(Held *held, PyObject *const objects[5])
{
    const Py_buffer *before, *now, *weights = NULL, *clipped;
    const float *log_exposure;
    Change change;
    if (!(before = hold_bytes(held, objects[0], 2, PyBUF_ND, "before")) ||
        !(now = hold_bytes(held, objects[1], 2, PyBUF_ND, "now")) ||
        (objects[2] != Py_None && !(weights = hold_bytes(held, objects[2], 2, PyBUF_ND, "weights"))) ||
        !(log_exposure = hold_floats(held, objects[3], GREY_LEVELS, "log_exposure")) ||
        !(clipped = hold_bytes(held, objects[4], 1, PyBUF_ND, "clipped")))
        return NULL;
    if (before->len != now->len || (weights && weights->len != now->len) || clipped->len != GREY_LEVELS)
        return PyErr_Format(PyExc_ValueError, "before, now and weights must be alike, and clipped have 256 entries");
    if (light_change(before->buf, now->buf, weights ? weights->buf : NULL, (size_t)now->len, log_exposure, clipped->buf,
                     &change))
        return PyErr_NoMemory();
    return Py_BuildValue("nnd", (Py_ssize_t)change.counted, (Py_ssize_t)change.known, change.median);
}

static PyObject *light_change_of(PyObject *module, PyObject *arguments)
{
    PyObject *objects[5];
    Held held = {0};
    (void)module;
    if (!PyArg_ParseTuple(arguments, "OOOOO", &objects[0], &objects[1], &objects[2], &objects[3], &objects[4]))
        return NULL;
    PyObject *result = change_of(&held, objects);
    release(&held);
    return result;
}

PyDoc_STRVAR(median_shift_doc,
             "median_shift(image, side, light_of_sum, before, now)\n--\n\n"
             "How far the picture has moved, the median of its parts, in pixels; None: nothing to go by, or no picture before.\n\n"
             "image: uint8 (height, width), 16 to 90 blocks of `side` pixels either way. light_of_sum: int16\n"
             " (side * side * 255 + 1,), the light of a block in 1/128 stop by the sum of its grey levels, 0 if black, at\n"
             "most 2047. before: int16 (height // side, width // side), the light of the previous picture, or None.\n"
             "now: the same of this one, written.");

static int are_blocks(Py_ssize_t count)
{
    return count >= LEAST_BLOCKS && count <= MOST_BLOCKS;
}

static PyObject *shift_into(Held *held, PyObject *const objects[4], Py_ssize_t side)
{
    const Py_buffer *image;
    const int16_t *light_of_sum, *before = NULL;
    int16_t *now;
    if (!(image = hold_bytes(held, objects[0], 2, PyBUF_STRIDES, "image")))
        return NULL;
    if (side < 1 || side > LARGEST_BLOCK || !are_blocks(image->shape[0] / side) || !are_blocks(image->shape[1] / side))
        return PyErr_Format(PyExc_ValueError, "image must have %d to %d blocks either way, of 1 to %d pixels",
                            (int)LEAST_BLOCKS, (int)MOST_BLOCKS, (int)LARGEST_BLOCK);
    const Py_ssize_t height = image->shape[0] / side, width = image->shape[1] / side, last = side * side * 255;
    if (!(light_of_sum = hold_shorts(held, objects[1], last + 1, "light_of_sum")) ||
        (objects[2] != Py_None && !(before = hold_shorts(held, objects[2], height * width, "before"))) ||
        !(now = hold_short_results(held, objects[3], height * width, "now")))
        return NULL;
    if (light_of_sum[last] < 0 || light_of_sum[last] > BRIGHTEST)
        return PyErr_Format(PyExc_ValueError, "light_of_sum must end at 0 to %d", (int)BRIGHTEST);
    const Image pixels = image_of(image);
    if (light_of_blocks(&pixels, (size_t)side, light_of_sum, now))
        return PyErr_NoMemory();
    const double shift = before ? median_shift(before, now, (size_t)height, (size_t)width, light_of_sum[last]) : -1.0;
    if (isnan(shift))
        return PyErr_NoMemory();
    return shift < 0.0 ? Py_NewRef(Py_None) : PyFloat_FromDouble(shift * (double)side);
}

static PyObject *median_shift_of(PyObject *module, PyObject *arguments)
{
    PyObject *objects[4];
    Py_ssize_t side;
    Held held = {0};
    (void)module;
    if (!PyArg_ParseTuple(arguments, "OnOOO", &objects[0], &side, &objects[1], &objects[2], &objects[3]))
        return NULL;
    PyObject *result = shift_into(&held, objects, side);
    release(&held);
    return result;
}

PyMethodDef picture_methods[] = {
    {"contrast_sums", contrast_sums_of, METH_VARARGS, contrast_sums_doc},
    {"grey_counts", grey_counts_of, METH_VARARGS, grey_counts_doc},
    {"count_at_most", count_at_most_of, METH_VARARGS, count_at_most_doc},
    {"sample_greys", sample_greys_of, METH_VARARGS, sample_greys_doc},
    {"light_change", light_change_of, METH_VARARGS, light_change_doc},
    {"median_shift", median_shift_of, METH_VARARGS, median_shift_doc},
    {NULL, NULL, 0, NULL},
};
