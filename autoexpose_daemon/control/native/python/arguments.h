/* Arguments from Python, through the buffer protocol: independent of numpy's headers and version. */
#ifndef AUTOEXPOSE_ARGUMENTS_H
#define AUTOEXPOSE_ARGUMENTS_H

#define PY_SSIZE_T_CLEAN
#include <Python.h>
#include <stdint.h>

#include "picture/gradient.h"

/* The buffers that a call holds; starts as {0}. */
typedef struct {
    Py_buffer views[20];
    int count;
} Held;

void release(Held *held);

/* Each of those that hold gives NULL with an exception set if the object does not fit. */

/* Unsigned bytes with `dimensions` dimensions; flags: PyBUF_STRIDES, or PyBUF_ND for an array without gaps. */
const Py_buffer *hold_bytes(Held *held, PyObject *object, int dimensions, int flags, const char *what);

/* The numbers of a float64 array without gaps: `count` of them, or any number if that is negative. */
const double *hold_doubles(Held *held, PyObject *object, Py_ssize_t count, const char *what);

/* The same, to be written. */
double *hold_result(Held *held, PyObject *object, Py_ssize_t count, const char *what);

/* The same of float32, to be read. */
const float *hold_floats(Held *held, PyObject *object, Py_ssize_t count, const char *what);

/* The same of int16, to be read, and to be written. */
const int16_t *hold_shorts(Held *held, PyObject *object, Py_ssize_t count, const char *what);
int16_t *hold_short_results(Held *held, PyObject *object, Py_ssize_t count, const char *what);

/* How many numbers the last buffer has. */
Py_ssize_t held_numbers(const Held *held);

/* The product of two counts; one that no buffer has if it is too great. */
Py_ssize_t times(Py_ssize_t one, Py_ssize_t other);

/* 0 if there is no region or it has the shape of the image, else -1 with an exception set. */
int check_region(const Py_buffer *image, const Py_buffer *region);

Image image_of(const Py_buffer *view);

#endif
