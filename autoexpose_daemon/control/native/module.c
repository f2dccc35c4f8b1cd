/* gradient.h and contrast.h for Python, through the buffer protocol: independent of numpy's headers and version. */
#define PY_SSIZE_T_CLEAN
#include <Python.h>
#include <string.h>

#include "contrast.h"

/* Gets a buffer of unsigned bytes with `dimensions` dimensions; 0, or -1 with an exception set. */
static int hold_bytes(PyObject *object, Py_buffer *view, int dimensions, int flags, const char *what)
{
    if (PyObject_GetBuffer(object, view, flags | PyBUF_FORMAT) < 0)
        return -1;
    if (view->itemsize == 1 && view->ndim == dimensions && (!view->format || view->format[0] == 'B'))
        return 0;
    PyErr_Format(PyExc_ValueError, "%s must be an array of uint8 with %d dimension(s)", what, dimensions);
    PyBuffer_Release(view);
    return -1;
}

static Image image_of(const Py_buffer *view)
{
    return (Image){view->buf, view->strides[0], view->strides[1], (size_t)view->shape[0], (size_t)view->shape[1]};
}

static const InstructionSet *find_set(const char *name)
{
    const InstructionSet *set = instruction_sets();
    while (name && set->name && strcmp(set->name, name) != 0)
        set++;
    if (set->name)
        return set;
    PyErr_Format(PyExc_ValueError, "instruction set %s is not one that this processor has", name);
    return NULL;
}

static int check_region(const Py_buffer *image, const Py_buffer *region)
{
    if (!region || (region->shape[0] == image->shape[0] && region->shape[1] == image->shape[1]))
        return 0;
    PyErr_SetString(PyExc_ValueError, "region must have the shape of the image");
    return -1;
}

static int check_shapes(const Py_buffer *image, const Py_buffer *region, const Py_buffer *words,
                        const Py_buffer *weights)
{
    if (image->shape[0] < 2 || image->shape[1] < 2 || image->shape[1] > WIDEST)
        PyErr_Format(PyExc_ValueError, "an image of %zdx%zd pixels has no gradient here: at least 2x2, at most %d wide",
                     image->shape[1], image->shape[0], (int)WIDEST);
    else if (check_region(image, region))
        return -1;
    else if (weights->shape[0] != GREY_LEVELS)
        PyErr_SetString(PyExc_ValueError, "weights must have 256 entries");
    else if (words && (words->shape[1] != GREY_LEVELS || words->shape[2] != LANES))
        PyErr_SetString(PyExc_ValueError, "words must have the shape (n, 256, 8)");
    else
        return 0;
    return -1;
}

static PyObject *sums_of(const Py_buffer *image_view, const Py_buffer *region_view, const Py_buffer *words_view,
                         const uint8_t *weights, GradientSums *sum)
{
    const Image image = image_of(image_view);
    const Image region = region_view ? image_of(region_view) : (Image){0};
    const Py_ssize_t groups = words_view ? words_view->shape[0] : 1, lanes = words_view ? LANES : 1;
    PyObject *result = PyTuple_New(groups * lanes);
    for (Py_ssize_t group = 0; result && group < groups; group++) {
        const uint8_t *words = words_view ? (const uint8_t *)words_view->buf + group * GREY_LEVELS * LANES : NULL;
        uint64_t sums[LANES];
        int failed;
        Py_BEGIN_ALLOW_THREADS
        failed = sum(&image, region_view ? &region : NULL, words, weights, sums);
        Py_END_ALLOW_THREADS
        if (failed) {
            Py_DECREF(result);
            return PyErr_NoMemory();
        }
        for (Py_ssize_t lane = 0; lane < lanes; lane++) {
            PyObject *number = PyLong_FromUnsignedLongLong(sums[lane]);
            if (!number) {
                Py_DECREF(result);
                return NULL;
            }
            PyTuple_SetItem(result, group * lanes + lane, number);
        }
    }
    return result;
}

PyDoc_STRVAR(gradient_sums_doc,
             "gradient_sums(image, weights, words=None, region=None, instruction_set=None)\n--\n\n"
             "Sums over `image` of the weight of its gradient magnitude, exact: one int per table.\n\n"
             "image: uint8 (height, width). weights: uint8 (256,), of each magnitude. words: uint8 (n, 256, 8), 8n\n"
             "tables that the image is seen through; None for the image as it is. region: uint8 (height, width), what\n"
             "each pixel counts. instruction_set: one of INSTRUCTION_SETS; None for the best.");

static PyObject *gradient_sums(PyObject *module, PyObject *arguments, PyObject *keywords)
{
    static char *names[] = {"image", "weights", "words", "region", "instruction_set", NULL};
    PyObject *objects[4] = {NULL, NULL, Py_None, Py_None}, *result = NULL;
    const char *set_name = NULL;
    Py_buffer image, weights, words, region;
    (void)module;
    if (!PyArg_ParseTupleAndKeywords(arguments, keywords, "OO|OOz", names, &objects[0], &objects[1], &objects[2],
                                     &objects[3], &set_name))
        return NULL;
    const InstructionSet *set = find_set(set_name);
    const int has_words = objects[2] != Py_None, has_region = objects[3] != Py_None;
    if (!set || hold_bytes(objects[0], &image, 2, PyBUF_STRIDES, "image") < 0)
        return NULL;
    if (hold_bytes(objects[1], &weights, 1, PyBUF_ND, "weights") < 0)
        goto release_image;
    if (has_words && hold_bytes(objects[2], &words, 3, PyBUF_ND, "words") < 0)
        goto release_weights;
    if (has_region && hold_bytes(objects[3], &region, 2, PyBUF_STRIDES, "region") < 0)
        goto release_words;
    if (!check_shapes(&image, has_region ? &region : NULL, has_words ? &words : NULL, &weights))
        result = sums_of(&image, has_region ? &region : NULL, has_words ? &words : NULL, weights.buf, set->sums);
    if (has_region)
        PyBuffer_Release(&region);
release_words:
    if (has_words)
        PyBuffer_Release(&words);
release_weights:
    PyBuffer_Release(&weights);
release_image:
    PyBuffer_Release(&image);
    return result;
}

PyDoc_STRVAR(contrast_sums_doc,
             "contrast_sums(image, black, saturated, energy, count, region=None)\n--\n\n"
             "Collect the gradients of `image` by cell and bin of the brightest grey level into `energy` and `count`.\n\n"
             "image: uint8 (height, width), at least 3x3. black, saturated: the greatest grey level that is black, and the\n"
             "least that is saturated. energy, count: float64 (64, n), written, with n bins: see GreyBins. region: uint8\n"
             "(height, width), what each pixel counts.");

/* Gets a writable table of doubles; 0, or -1 with an exception set. */
static int hold_table(PyObject *object, Py_buffer *view, const char *what)
{
    if (PyObject_GetBuffer(object, view, PyBUF_CONTIG | PyBUF_FORMAT) < 0)
        return -1;
    const int doubles = view->format && view->format[0] == 'd';
    if (doubles && view->ndim == 2 && view->shape[0] == CELLS * CELLS)
        return 0;
    PyErr_Format(PyExc_ValueError, "%s must be an array of float64 with the shape (64, n)", what);
    PyBuffer_Release(view);
    return -1;
}

static int check_bins(int black, int saturated, const Py_buffer *energy, const Py_buffer *count)
{
    const Py_ssize_t bins = energy->shape[1];
    if (black < 0 || black >= saturated || saturated >= GREY_LEVELS)
        PyErr_SetString(PyExc_ValueError, "black must be at least 0, and below saturated, which is at most 255");
    else if (bins != count->shape[1] || bins != grey_bin(saturated - 1, black) + 2)
        PyErr_Format(PyExc_ValueError, "energy and count must have a column for each of the %d bins",
                     grey_bin(saturated - 1, black) + 2);
    else
        return 0;
    return -1;
}

static PyObject *contrast_into(const Py_buffer *image_view, const Py_buffer *region_view, int black, int saturated,
                               Py_buffer *energy, Py_buffer *count)
{
    if (image_view->shape[0] < 3 || image_view->shape[1] < 3 || image_view->shape[1] > WIDEST)
        return PyErr_Format(PyExc_ValueError, "an image of %zdx%zd pixels has no inside: at least 3x3, at most %d wide",
                            image_view->shape[1], image_view->shape[0], (int)WIDEST);
    if (check_region(image_view, region_view) || check_bins(black, saturated, energy, count))
        return NULL;
    const Image image = image_of(image_view), region = region_view ? image_of(region_view) : (Image){0};
    const GreyBins bins = {(uint8_t)black, (uint8_t)saturated, (uint8_t)(energy->shape[1] - 1)};
    int failed;
    Py_BEGIN_ALLOW_THREADS
    failed = contrast_sums(&image, region_view ? &region : NULL, bins, energy->buf, count->buf);
    Py_END_ALLOW_THREADS
    if (failed)
        return PyErr_NoMemory();
    Py_RETURN_NONE;
}

static PyObject *contrast_sums_of(PyObject *module, PyObject *arguments, PyObject *keywords)
{
    static char *names[] = {"image", "black", "saturated", "energy", "count", "region", NULL};
    PyObject *objects[4] = {NULL, NULL, NULL, Py_None}, *result = NULL;
    int black, saturated;
    Py_buffer image, energy, count, region;
    (void)module;
    if (!PyArg_ParseTupleAndKeywords(arguments, keywords, "OiiOO|O", names, &objects[0], &black, &saturated,
                                     &objects[1], &objects[2], &objects[3]))
        return NULL;
    const int has_region = objects[3] != Py_None;
    if (hold_bytes(objects[0], &image, 2, PyBUF_STRIDES, "image") < 0)
        return NULL;
    if (hold_table(objects[1], &energy, "energy") < 0)
        goto release_image;
    if (hold_table(objects[2], &count, "count") < 0)
        goto release_energy;
    if (has_region && hold_bytes(objects[3], &region, 2, PyBUF_STRIDES, "region") < 0)
        goto release_count;
    result = contrast_into(&image, has_region ? &region : NULL, black, saturated, &energy, &count);
    if (has_region)
        PyBuffer_Release(&region);
release_count:
    PyBuffer_Release(&count);
release_energy:
    PyBuffer_Release(&energy);
release_image:
    PyBuffer_Release(&image);
    return result;
}

static PyObject *set_names(void)
{
    const InstructionSet *sets = instruction_sets();
    Py_ssize_t count = 0;
    while (sets[count].name)
        count++;
    PyObject *names = PyTuple_New(count);
    for (Py_ssize_t i = 0; names && i < count; i++) {
        PyObject *name = PyUnicode_FromString(sets[i].name);
        if (!name) {
            Py_DECREF(names);
            return NULL;
        }
        PyTuple_SetItem(names, i, name);
    }
    return names;
}

static PyMethodDef methods[] = {
    {"gradient_sums", (PyCFunction)(void (*)(void))gradient_sums, METH_VARARGS | METH_KEYWORDS, gradient_sums_doc},
    {"contrast_sums", (PyCFunction)(void (*)(void))contrast_sums_of, METH_VARARGS | METH_KEYWORDS, contrast_sums_doc},
    {NULL, NULL, 0, NULL},
};

static struct PyModuleDef definition = {
    .m_base = PyModuleDef_HEAD_INIT,
    .m_name = "_native",
    .m_doc = "Sums over the gradients of an image, each in one pass.",
    .m_size = -1,
    .m_methods = methods,
};

PyMODINIT_FUNC PyInit__native(void)
{
    PyObject *module = PyModule_Create(&definition), *names = module ? set_names() : NULL;
    if (!names || PyModule_AddObjectRef(module, "INSTRUCTION_SETS", names) < 0)
        Py_CLEAR(module);
    Py_XDECREF(names);
    return module;
}
