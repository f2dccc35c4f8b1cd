/* split.h for Python. */
#include "arguments.h"
#include "bindings.h"
#include "belief/split.h"

PyDoc_STRVAR(best_times_doc,
             "best_times(levels, shortest, longest, least_gain, greatest_gain, shot, read, pixels, speed, scale, times_us)\n"
             "--\n\n"
             "The best exposure time for each level, as BlurPhotonBalance has it, into `times_us`; both float64 (n,).\n\n"
             "shortest, longest: log2 of us. least_gain, greatest_gain: stops. shot, read: factors of the variance. pixels:\n"
             "averaged into one. speed: pixels of the frame in a us, `scale` of which are one of the image.");

static PyObject *best_times_of(PyObject *module, PyObject *arguments)
{
    PyObject *given, *written, *result = NULL;
    const double *levels;
    double *times_us;
    Bounds bounds;
    Middle middle;
    Held held = {0};
    (void)module;
    if (!PyArg_ParseTuple(arguments, "OdddddddddO", &given, &bounds.shortest, &bounds.longest, &bounds.least_gain,
                          &bounds.greatest_gain, &middle.shot, &middle.read, &middle.pixels, &middle.speed,
                          &middle.scale, &written))
        return NULL;
    if ((levels = hold_doubles(&held, given, -1, "levels")) &&
        (times_us = hold_result(&held, written, held_numbers(&held), "times_us"))) {
        best_times(levels, (size_t)held_numbers(&held), &bounds, &middle, times_us);
        result = Py_NewRef(Py_None);
    }
    release(&held);
    return result;
}

PyDoc_STRVAR(split_levels_doc, "split_levels(levels, times_us, speed, now_us, gains, sharp)\n--\n\n"
                               "Linear gains of levels at exposure times, and how sharp images are there (split.h), into `gains` and\n"
                               "`sharp`; all float64 (n,). speed: pixels of the image in a us.");

static PyObject *split_levels_of(PyObject *module, PyObject *arguments)
{
    PyObject *given, *given_us, *of_gains, *of_sharp, *result = NULL;
    const double *levels, *times_us;
    double speed, now_us, *gains, *sharp;
    Held held = {0};
    (void)module;
    if (!PyArg_ParseTuple(arguments, "OOddOO", &given, &given_us, &speed, &now_us, &of_gains, &of_sharp))
        return NULL;
    if ((levels = hold_doubles(&held, given, -1, "levels")) &&
        (times_us = hold_doubles(&held, given_us, held_numbers(&held), "times_us")) &&
        (gains = hold_result(&held, of_gains, held_numbers(&held), "gains")) &&
        (sharp = hold_result(&held, of_sharp, held_numbers(&held), "sharp"))) {
        split_levels(levels, times_us, (size_t)held_numbers(&held), speed, now_us, gains, sharp);
        result = Py_NewRef(Py_None);
    }
    release(&held);
    return result;
}

PyMethodDef split_methods[] = {
    {"best_times", best_times_of, METH_VARARGS, best_times_doc},
    {"split_levels", split_levels_of, METH_VARARGS, split_levels_doc},
    {NULL, NULL, 0, NULL},
};
