#include "arguments.h"

#include <string.h>

void release(Held *held)
{
    while (held->count)
        PyBuffer_Release(&held->views[--held->count]);
}

static Py_buffer *hold(Held *held, PyObject *object, int flags)
{
    Py_buffer *view = &held->views[held->count];
    if (PyObject_GetBuffer(object, view, flags | PyBUF_FORMAT) < 0)
        return NULL;
    held->count++;
    return view;
}

const Py_buffer *hold_bytes(Held *held, PyObject *object, int dimensions, int flags, const char *what)
{
    const Py_buffer *view = hold(held, object, flags);
    if (!view || (view->itemsize == 1 && view->ndim == dimensions && (!view->format || view->format[0] == 'B')))
        return view;
    PyErr_Format(PyExc_ValueError, "%s must be an array of uint8 with %d dimension(s)", what, dimensions);
    return NULL;
}

static void *numbers(Held *held, PyObject *object, Py_ssize_t count, const char *format, int flags, const char *what)
{
    const Py_buffer *view = hold(held, object, PyBUF_ND | flags);
    if (!view)
        return NULL;
    if (!view->format || strcmp(view->format, format) != 0)
        PyErr_Format(PyExc_ValueError, "%s must be an array of type '%s'", what, format);
    else if (count >= 0 && view->len / view->itemsize != count)
        PyErr_Format(PyExc_ValueError, "%s must have %zd numbers", what, count);
    else if (view->len && (uintptr_t)view->buf % (size_t)view->itemsize)
        PyErr_Format(PyExc_ValueError, "%s must be aligned: its numbers begin at an odd address", what);
    else
        return view->buf;
    return NULL;
}

const double *hold_doubles(Held *held, PyObject *object, Py_ssize_t count, const char *what)
{
    return numbers(held, object, count, "d", 0, what);
}

double *hold_result(Held *held, PyObject *object, Py_ssize_t count, const char *what)
{
    return numbers(held, object, count, "d", PyBUF_WRITABLE, what);
}

const float *hold_floats(Held *held, PyObject *object, Py_ssize_t count, const char *what)
{
    return numbers(held, object, count, "f", 0, what);
}

const int16_t *hold_shorts(Held *held, PyObject *object, Py_ssize_t count, const char *what)
{
    return numbers(held, object, count, "h", 0, what);
}

int16_t *hold_short_results(Held *held, PyObject *object, Py_ssize_t count, const char *what)
{
    return numbers(held, object, count, "h", PyBUF_WRITABLE, what);
}

Py_ssize_t held_numbers(const Held *held)
{
    return held->views[held->count - 1].len / held->views[held->count - 1].itemsize;
}

Py_ssize_t times(Py_ssize_t one, Py_ssize_t other)
{
    Py_ssize_t product;
    return __builtin_mul_overflow(one, other, &product) ? PY_SSIZE_T_MAX : product;
}

int check_region(const Py_buffer *image, const Py_buffer *region)
{
    if (!region || (region->shape[0] == image->shape[0] && region->shape[1] == image->shape[1]))
        return 0;
    PyErr_SetString(PyExc_ValueError, "region must have the shape of the image");
    return -1;
}

Image image_of(const Py_buffer *view)
{
    return (Image){view->buf, view->strides[0], view->strides[1], (size_t)view->shape[0], (size_t)view->shape[1]};
}
