/* forecast.h and plan.h for Python. */
#include "arguments.h"
#include "bindings.h"
#include "belief/forecast.h"
#include "belief/plan.h"

PyDoc_STRVAR(find_period_doc,
             "find_period(changes, least_frames, least_variance, residue)\n--\n\n"
             "After how many frames changes of light, float64 (n,), oldest first, repeat themselves; 0: they do not.");

static PyObject *find_period_of(PyObject *module, PyObject *arguments)
{
    PyObject *object, *result = NULL;
    Py_ssize_t least_frames;
    Pattern pattern;
    Held held = {0};
    (void)module;
    if (!PyArg_ParseTuple(arguments, "Ondd", &object, &least_frames, &pattern.least_variance, &pattern.residue))
        return NULL;
    const double *changes = hold_doubles(&held, object, -1, "changes");
    pattern.least_frames = (size_t)least_frames;
    if (changes && least_frames < 0)
        PyErr_SetString(PyExc_ValueError, "least_frames must not be negative");
    else if (changes)
        result = PyLong_FromSize_t(find_period(changes, (size_t)held_numbers(&held), &pattern));
    release(&held);
    return result;
}

PyDoc_STRVAR(weigh_levels_doc,
             "weigh_levels(information, favoured, revealed, probability, votes, sharp, hope, least_camera, steering_share,\n"
             "             served, worth, look)\n--\n\n"
             "What levels are worth to all cameras now, and for what they would reveal: `worth`, `look`, written.\n\n"
             "All float64. information, favoured, revealed: (cameras, 4, n); favoured: or None. probability: (cameras, 4).\n"
             "votes: (cameras,). sharp, worth, look: (n,), at least 1. hope, least_camera, steering_share: as in policy.py.\n"
             "served: frames.");

static PyObject *weigh_levels_of(PyObject *module, PyObject *arguments)
{
    PyObject *information, *favoured, *revealed, *probability, *votes, *sharp, *worths, *looks, *result = NULL;
    double *worth, *look;
    Expected expected = {0};
    Held held = {0};
    (void)module;
    if (!PyArg_ParseTuple(arguments, "OOOOOOddddOO", &information, &favoured, &revealed, &probability, &votes, &sharp,
                          &expected.hope, &expected.least_camera, &expected.steering_share, &expected.served, &worths,
                          &looks))
        return NULL;
    int fits = (expected.votes = hold_doubles(&held, votes, -1, "votes")) != NULL;
    const Py_ssize_t hypotheses = fits ? times(HYPOTHESES, held_numbers(&held)) : 0;
    fits = fits && (expected.sharp = hold_doubles(&held, sharp, -1, "sharp"));
    const Py_ssize_t n = fits ? held_numbers(&held) : 0, all = times(hypotheses, n);
    expected.cameras = (size_t)hypotheses / HYPOTHESES;
    expected.levels = (size_t)n;
    fits = fits && (expected.information = hold_doubles(&held, information, all, "information")) &&
           (favoured == Py_None || (expected.favoured = hold_doubles(&held, favoured, all, "favoured"))) &&
           (expected.revealed = hold_doubles(&held, revealed, all, "revealed")) &&
           (expected.probability = hold_doubles(&held, probability, hypotheses, "probability")) &&
           (worth = hold_result(&held, worths, n, "worth")) && (look = hold_result(&held, looks, n, "look"));
    if (fits && !n)
        PyErr_SetString(PyExc_ValueError, "sharp must have a number for each level, at least one");
    else if (fits)
        result = weigh_levels(&expected, worth, look) ? PyErr_NoMemory() : Py_NewRef(Py_None);
    release(&held);
    return result;
}

PyDoc_STRVAR(plan_frames_doc,
             "plan_frames(worth, look, light, chances, lowest, step, before, brightness_loss, lost_below,\n"
             "            lost_cost, values, looks)\n--\n\n"
             "What levels promise for the first of some frames, if the best follows; as plan.py has it, with the parameters.\n\n"
             "All float64. worth, look: (n,), at least 2. light: (paths, frames + 1). chances: (paths,). values, looks: (n - 2k,),\n"
             "written, of the levels from `lowest` on, stops.");

static PyObject *plan_frames_of(PyObject *module, PyObject *arguments)
{
    PyObject *worth, *look, *light, *chances, *promised, *of_looks, *result = NULL;
    double *values, *looks;
    Plan plan;
    Held held = {0};
    (void)module;
    if (!PyArg_ParseTuple(arguments, "OOOOddddddOO", &worth, &look, &light, &chances, &plan.lowest, &plan.step,
                          &plan.before, &plan.brightness_loss, &plan.lost_below, &plan.lost_cost, &promised, &of_looks))
        return NULL;
    int fits = (plan.worth = hold_doubles(&held, worth, -1, "worth")) != NULL;
    const Py_ssize_t n = fits ? held_numbers(&held) : 0;
    fits = fits && (plan.look = hold_doubles(&held, look, n, "look")) &&
           (plan.chances = hold_doubles(&held, chances, -1, "chances"));
    const Py_ssize_t paths = fits ? held_numbers(&held) : 0;
    fits = fits && (plan.light = hold_doubles(&held, light, -1, "light"));
    const Py_ssize_t stops = fits ? held_numbers(&held) : 0, frames = paths ? stops / paths - 1 : 0;
    fits = fits && (values = hold_result(&held, promised, -1, "values"));
    const Py_ssize_t planned = fits ? held_numbers(&held) : 0;
    fits = fits && (looks = hold_result(&held, of_looks, planned, "looks"));
    plan.levels = (size_t)n;
    plan.beyond = (size_t)(n - planned) / 2;
    plan.frames = (size_t)frames;
    plan.paths = (size_t)paths;
    if (fits && (n < 2 || planned < 1 || planned > n || (n - planned) % 2 || frames < 1 || stops != paths * (frames + 1)))
        PyErr_SetString(PyExc_ValueError, "worth, values and light do not have the shapes of one plan");
    else if (fits)
        result = plan_frames(&plan, values, looks) ? PyErr_NoMemory() : Py_NewRef(Py_None);
    release(&held);
    return result;
}

PyMethodDef plan_methods[] = {
    {"find_period", find_period_of, METH_VARARGS, find_period_doc},
    {"weigh_levels", weigh_levels_of, METH_VARARGS, weigh_levels_doc},
    {"plan_frames", plan_frames_of, METH_VARARGS, plan_frames_doc},
    {NULL, NULL, 0, NULL},
};
