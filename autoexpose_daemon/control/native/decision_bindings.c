/* information.h, split.h and sightings.h for Python. */
#include "arguments.h"
#include "bindings.h"
#include "information.h"
#include "sightings.h"
#include "split.h"

PyDoc_STRVAR(predict_information_doc,
             "predict_information(energy, count, now, then, pixels, gain, gains, sharper, relative_light, cell_weights,\n"
             "                    curve, steered)\n--\n\n"
             "The curves of InformationPrediction, which also has the parameters; written, float64 (n,).\n\n"
             "energy, count: those of Contrast. now: float64 (3, bins), readable share and factors of shot and read noise.\n"
             "then: float64 (3, bins, n), factors of contrast, shot and read noise. relative_light, cell_weights: float64\n"
             "(64,), or None. steered: None without cell_weights.");

static PyObject *information_into(Held *held, PyObject *const objects[10], double pixels, double gain)
{
    enum { ENERGY, COUNT, NOW, THEN, GAINS, SHARPER, LIGHT, WEIGHTS, CURVE, STEERED };
    const int has_light = objects[LIGHT] != Py_None, is_steered = objects[WEIGHTS] != Py_None;
    const double *energy, *count, *now, *then, *gains, *sharper, *light = NULL, *weights = NULL;
    double *curve, *steered = NULL;
    if (!(now = hold_doubles(held, objects[NOW], -1, "now")))
        return NULL;
    const Py_ssize_t bins = held_numbers(held) / 3;
    if (!(gains = hold_doubles(held, objects[GAINS], -1, "gains")))
        return NULL;
    const Py_ssize_t n = held_numbers(held), cells = ALL_CELLS;
    if (!(energy = hold_doubles(held, objects[ENERGY], times(cells, bins), "energy")) ||
        !(count = hold_doubles(held, objects[COUNT], times(cells, bins), "count")) ||
        !(then = hold_doubles(held, objects[THEN], times(3, times(bins, n)), "then")) ||
        !(sharper = hold_doubles(held, objects[SHARPER], n, "sharper")) ||
        (has_light && !(light = hold_doubles(held, objects[LIGHT], cells, "relative_light"))) ||
        (is_steered && !(weights = hold_doubles(held, objects[WEIGHTS], cells, "cell_weights"))) ||
        !(curve = hold_result(held, objects[CURVE], n, "curve")) ||
        (is_steered && !(steered = hold_result(held, objects[STEERED], n, "steered"))))
        return NULL;
    const Prediction prediction = {(size_t)bins, (size_t)n, now, now + bins, now + 2 * bins,
                                   then, then + bins * n, then + 2 * bins * n};
    const Exposures taken = {pixels, gain, gains, sharper, light, weights};
    if (predict_information(&prediction, &taken, energy, count, curve, steered))
        return PyErr_NoMemory();
    Py_RETURN_NONE;
}

static PyObject *predict_information_of(PyObject *module, PyObject *arguments)
{
    PyObject *objects[10];
    double pixels, gain;
    Held held = {0};
    (void)module;
    if (!PyArg_ParseTuple(arguments, "OOOOddOOOOOO", &objects[0], &objects[1], &objects[2], &objects[3], &pixels, &gain,
                          &objects[4], &objects[5], &objects[6], &objects[7], &objects[8], &objects[9]))
        return NULL;
    PyObject *result = information_into(&held, objects, pixels, gain);
    release(&held);
    return result;
}

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
                               "Linear gains of levels at exposure times, and the root of `sharper` there, into `gains` and\n"
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

PyDoc_STRVAR(predict_metrics_doc,
             "predict_metrics(levels, places, ages, blind, curves, deltas, doubting, values, distances)\n--\n\n"
             "What sightings predict at levels, and how far away those are, as MetricMemory has it; all float64.\n\n"
             "levels: (n,). places, ages: (sightings,). blind: (sightings, cameras). curves: (sightings, cameras, deltas).\n"
             "deltas: at least 2, rising. values, distances: (sightings, cameras, n), written.");

static PyObject *metrics_into(Held *held, PyObject *const objects[8], int doubting)
{
    enum { LEVELS, PLACES, AGES, BLIND, CURVES, DELTAS, VALUES, DISTANCES };
    Sightings seen;
    double *values, *distances;
    const double *levels = hold_doubles(held, objects[LEVELS], -1, "levels");
    const Py_ssize_t n = levels ? held_numbers(held) : 0;
    if (!levels || !(seen.levels = hold_doubles(held, objects[PLACES], -1, "places")))
        return NULL;
    const Py_ssize_t sightings = held_numbers(held);
    if (!(seen.ages = hold_doubles(held, objects[AGES], sightings, "ages")) ||
        !(seen.blind = hold_doubles(held, objects[BLIND], -1, "blind")))
        return NULL;
    const Py_ssize_t views = held_numbers(held), cameras = sightings ? views / sightings : 0;
    if (!(seen.delta = hold_doubles(held, objects[DELTAS], -1, "deltas")))
        return NULL;
    const Py_ssize_t deltas = held_numbers(held);
    if (views != sightings * cameras || deltas < 2)
        return PyErr_Format(PyExc_ValueError, "blind must have the shape (sightings, cameras), deltas at least 2 numbers");
    if (!(seen.curves = hold_doubles(held, objects[CURVES], times(views, deltas), "curves")) ||
        !(values = hold_result(held, objects[VALUES], times(views, n), "values")) ||
        !(distances = hold_result(held, objects[DISTANCES], times(views, n), "distances")))
        return NULL;
    seen.count = (size_t)sightings;
    seen.cameras = (size_t)cameras;
    seen.deltas = (size_t)deltas;
    predict_metrics(&seen, levels, (size_t)n, doubting, values, distances);
    Py_RETURN_NONE;
}

static PyObject *predict_metrics_of(PyObject *module, PyObject *arguments)
{
    PyObject *objects[8];
    int doubting;
    Held held = {0};
    (void)module;
    if (!PyArg_ParseTuple(arguments, "OOOOOOpOO", &objects[0], &objects[1], &objects[2], &objects[3], &objects[4],
                          &objects[5], &doubting, &objects[6], &objects[7]))
        return NULL;
    PyObject *result = metrics_into(&held, objects, doubting);
    release(&held);
    return result;
}

PyDoc_STRVAR(worth_of_levels_doc,
             "worth_of_levels(levels, metrics, views, moving, shortest_stops, power, probe_worth, frontier, known_again, "
             "highest, worth)\n--\n\n"
             "As in search.py, which also has the parameters; `worth`, float64 (n,), is written.");

static PyObject *worth_into(Held *held, PyObject *const objects[4], Unseen *unseen)
{
    const double *levels, *metrics;
    double *worth;
    if (!(unseen->saturated = hold_doubles(held, objects[2], -1, "views")))
        return NULL;
    const Py_ssize_t cameras = held_numbers(held) / 3;
    if (!(levels = hold_doubles(held, objects[0], -1, "levels")))
        return NULL;
    const Py_ssize_t n = held_numbers(held);
    if (!(metrics = hold_doubles(held, objects[1], times(cameras, n), "metrics")) ||
        !(worth = hold_result(held, objects[3], n, "worth")))
        return NULL;
    unseen->black = unseen->saturated + cameras;
    unseen->density = unseen->black + cameras;
    worth_of_levels(levels, (size_t)n, metrics, (size_t)cameras, unseen, worth);
    Py_RETURN_NONE;
}

static PyObject *worth_of_levels_of(PyObject *module, PyObject *arguments)
{
    PyObject *objects[4];
    Unseen unseen;
    Held held = {0};
    (void)module;
    if (!PyArg_ParseTuple(arguments, "OOOpddddddO", &objects[0], &objects[1], &objects[2], &unseen.moving,
                          &unseen.shortest, &unseen.power, &unseen.worth, &unseen.frontier, &unseen.known_again,
                          &unseen.highest, &objects[3]))
        return NULL;
    PyObject *result = worth_into(&held, objects, &unseen);
    release(&held);
    return result;
}

PyMethodDef decision_methods[] = {
    {"predict_information", predict_information_of, METH_VARARGS, predict_information_doc},
    {"predict_metrics", predict_metrics_of, METH_VARARGS, predict_metrics_doc},
    {"worth_of_levels", worth_of_levels_of, METH_VARARGS, worth_of_levels_doc},
    {"best_times", best_times_of, METH_VARARGS, best_times_doc},
    {"split_levels", split_levels_of, METH_VARARGS, split_levels_doc},
    {NULL, NULL, 0, NULL},
};
