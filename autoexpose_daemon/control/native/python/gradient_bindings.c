/* gradient.h for Python. */
#include <string.h>

#include "arguments.h"
#include "bindings.h"

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

static PyObject *sums_of_objects(Held *held, PyObject *const objects[4], const char *set_name)
{
    const InstructionSet *set = find_set(set_name);
    const Py_buffer *image, *weights, *words = NULL, *region = NULL;
    if (!set || !(image = hold_bytes(held, objects[0], 2, PyBUF_STRIDES, "image")) ||
        !(weights = hold_bytes(held, objects[1], 1, PyBUF_ND, "weights")) ||
        (objects[2] != Py_None && !(words = hold_bytes(held, objects[2], 3, PyBUF_ND, "words"))) ||
        (objects[3] != Py_None && !(region = hold_bytes(held, objects[3], 2, PyBUF_STRIDES, "region"))) ||
        check_shapes(image, region, words, weights))
        return NULL;
    return sums_of(image, region, words, weights->buf, set->sums);
}

static PyObject *gradient_sums(PyObject *module, PyObject *arguments, PyObject *keywords)
{
    static char *names[] = {"image", "weights", "words", "region", "instruction_set", NULL};
    PyObject *objects[4] = {NULL, NULL, Py_None, Py_None};
    const char *set_name = NULL;
    Held held = {0};
    (void)module;
    if (!PyArg_ParseTupleAndKeywords(arguments, keywords, "OO|OOz", names, &objects[0], &objects[1], &objects[2],
                                     &objects[3], &set_name))
        return NULL;
    PyObject *result = sums_of_objects(&held, objects, set_name);
    release(&held);
    return result;
}

PyObject *set_names(void)
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

PyMethodDef gradient_methods[] = {
    {"gradient_sums", (PyCFunction)(void (*)(void))gradient_sums, METH_VARARGS | METH_KEYWORDS, gradient_sums_doc},
    {NULL, NULL, 0, NULL},
};
