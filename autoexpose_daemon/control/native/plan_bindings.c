/* plan.h for Python. */
#include "arguments.h"
#include "bindings.h"
#include "plan.h"

PyDoc_STRVAR(weigh_levels_doc,
             "weigh_levels(information, favoured, revealed, probability, votes, sharp, least_camera, steering_share, served,\n"
             "             worth, look)\n--\n\n"
             "What levels are worth to all cameras now, and for what they would reveal: `worth`, `look`, written.\n\n"
             "All float64. information, favoured, revealed: (cameras, 3, n); favoured: or None. probability: (cameras, 3).\n"
             "votes: (cameras,). sharp, worth, look: (n,), at least 1. least_camera, steering_share: as in policy.py. served:\n"
             "frames.");

static PyObject *levels_into(Held *held, PyObject *const objects[8], Expected *expected)
{
    enum { INFORMATION, FAVOURED, REVEALED, PROBABILITY, VOTES, SHARP, WORTH, LOOK };
    const int steered = objects[FAVOURED] != Py_None;
    double *worth, *look;
    if (!(expected->votes = hold_doubles(held, objects[VOTES], -1, "votes")))
        return NULL;
    const Py_ssize_t cameras = held_numbers(held), hypotheses = times(cameras, HYPOTHESES);
    if (!(expected->sharp = hold_doubles(held, objects[SHARP], -1, "sharp")))
        return NULL;
    const Py_ssize_t n = held_numbers(held), all = times(hypotheses, n);
    expected->favoured = NULL;
    if (!(expected->information = hold_doubles(held, objects[INFORMATION], all, "information")) ||
        (steered && !(expected->favoured = hold_doubles(held, objects[FAVOURED], all, "favoured"))) ||
        !(expected->revealed = hold_doubles(held, objects[REVEALED], all, "revealed")) ||
        !(expected->probability = hold_doubles(held, objects[PROBABILITY], hypotheses, "probability")) ||
        !(worth = hold_result(held, objects[WORTH], n, "worth")) || !(look = hold_result(held, objects[LOOK], n, "look")))
        return NULL;
    if (n < 1)
        return PyErr_Format(PyExc_ValueError, "sharp must have a number for each level, at least one");
    expected->cameras = (size_t)cameras;
    expected->levels = (size_t)n;
    if (weigh_levels(expected, worth, look))
        return PyErr_NoMemory();
    Py_RETURN_NONE;
}

static PyObject *weigh_levels_of(PyObject *module, PyObject *arguments)
{
    PyObject *objects[8];
    Expected expected;
    Held held = {0};
    (void)module;
    if (!PyArg_ParseTuple(arguments, "OOOOOOdddOO", &objects[0], &objects[1], &objects[2], &objects[3], &objects[4],
                          &objects[5], &expected.least_camera, &expected.steering_share, &expected.served, &objects[6],
                          &objects[7]))
        return NULL;
    PyObject *result = levels_into(&held, objects, &expected);
    release(&held);
    return result;
}

PyDoc_STRVAR(plan_frames_doc,
             "plan_frames(worth, look, light, chances, lowest, step, before, brightness_loss, values, looks)\n--\n\n"
             "What levels promise for the first of some frames, if the best follows; as plan.py has it, with the parameters.\n\n"
             "All float64. worth, look: (n,), at least 2. light: (paths, frames + 1). chances: (paths,). values, looks: (n - 2k,),\n"
             "written, of the levels from `lowest` on, stops.");

static PyObject *plan_into(Held *held, PyObject *const objects[6], Plan *plan)
{
    enum { WORTH, LOOK, LIGHT, CHANCES, VALUES, LOOKS };
    double *values, *looks;
    if (!(plan->worth = hold_doubles(held, objects[WORTH], -1, "worth")))
        return NULL;
    const Py_ssize_t n = held_numbers(held);
    if (!(plan->look = hold_doubles(held, objects[LOOK], n, "look")) ||
        !(plan->chances = hold_doubles(held, objects[CHANCES], -1, "chances")))
        return NULL;
    const Py_ssize_t paths = held_numbers(held);
    if (!(plan->light = hold_doubles(held, objects[LIGHT], -1, "light")))
        return NULL;
    const Py_ssize_t stops = held_numbers(held), frames = paths ? stops / paths - 1 : 0;
    if (!(values = hold_result(held, objects[VALUES], -1, "values")))
        return NULL;
    const Py_ssize_t planned = held_numbers(held);
    if (!(looks = hold_result(held, objects[LOOKS], planned, "looks")))
        return NULL;
    if (n < 2 || planned < 1 || planned > n || (n - planned) % 2 || frames < 1 || stops != paths * (frames + 1))
        return PyErr_Format(PyExc_ValueError, "worth, values and light do not have the shapes of one plan");
    plan->levels = (size_t)n;
    plan->beyond = (size_t)(n - planned) / 2;
    plan->frames = (size_t)frames;
    plan->paths = (size_t)paths;
    if (plan_frames(plan, values, looks))
        return PyErr_NoMemory();
    Py_RETURN_NONE;
}

static PyObject *plan_frames_of(PyObject *module, PyObject *arguments)
{
    PyObject *objects[6];
    Plan plan;
    Held held = {0};
    (void)module;
    if (!PyArg_ParseTuple(arguments, "OOOOddddOO", &objects[0], &objects[1], &objects[2], &objects[3], &plan.lowest,
                          &plan.step, &plan.before, &plan.brightness_loss, &objects[4], &objects[5]))
        return NULL;
    PyObject *result = plan_into(&held, objects, &plan);
    release(&held);
    return result;
}

PyMethodDef plan_methods[] = {
    {"weigh_levels", weigh_levels_of, METH_VARARGS, weigh_levels_doc},
    {"plan_frames", plan_frames_of, METH_VARARGS, plan_frames_doc},
    {NULL, NULL, 0, NULL},
};
