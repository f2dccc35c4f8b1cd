/* belief.h for Python. */
#include "arguments.h"
#include "belief.h"
#include "bindings.h"

/* Of a call; `rules`, `scene` and `optics` are tuples. */
typedef struct {
    Rules rules;
    Scene scene;
    Optics optics;
} Belief;

static int hold_rules(PyObject *object, Rules *rules)
{
    return PyArg_ParseTuple(object, "dddddddddd", &rules->lowest, &rules->bin, &rules->renewed, &rules->least_look,
                            &rules->longest_tail, &rules->detached, &rules->detached_tail, &rules->half_detached_tail,
                            &rules->neighbours[0], &rules->neighbours[1]);
}

static int hold_scene(Held *held, PyObject *object, Scene *scene)
{
    PyObject *arrays[8];
    if (!PyArg_ParseTuple(object, "OOOOOOOO", &arrays[0], &arrays[1], &arrays[2], &arrays[3], &arrays[4], &arrays[5],
                          &arrays[6], &arrays[7]) ||
        !(scene->seen = hold_result(held, arrays[3], -1, "seen")))
        return 0;
    const Py_ssize_t bins = held_numbers(held), places = times(ALL_CELLS, bins), sides = SIDES * ALL_CELLS;
    scene->bins = (size_t)bins;
    return (scene->mass = (void *)hold_result(held, arrays[0], places, "mass")) &&
           (scene->energy = (void *)hold_result(held, arrays[1], places, "energy")) &&
           (scene->precision = (void *)hold_result(held, arrays[2], places, "precision")) &&
           (scene->bounds = hold_result(held, arrays[4], SIDES, "bounds")) &&
           (scene->hidden = (void *)hold_result(held, arrays[5], sides, "hidden")) &&
           (scene->tail = (void *)hold_result(held, arrays[6], sides, "tail")) &&
           (scene->richness = (void *)hold_result(held, arrays[7], sides, "richness"));
}

static int hold_optics(Held *held, PyObject *object, const Rules *rules, Optics *optics)
{
    PyObject *of_bins, *of_places;
    const double *bins, *places;
    if (!PyArg_ParseTuple(object, "OOnd", &of_bins, &of_places, &optics->first, &optics->step) ||
        !(bins = hold_doubles(held, of_bins, -1, "by_bin")))
        return 0;
    const size_t greys = optics->bins = (size_t)held_numbers(held) / 7;
    if (!(places = hold_doubles(held, of_places, -1, "by_exposure")))
        return 0;
    const size_t exposures = optics->places = (size_t)held_numbers(held) / 3;
    if (greys < 3 || !exposures || !(optics->step > 0.0) || !(SAMPLES * optics->step <= rules->bin)) {
        PyErr_SetString(PyExc_ValueError, "optics must have 3 bins or more, and 4 log exposures in a bin of radiance");
        return 0;
    }
    optics->readable = bins;
    optics->low = bins + greys;
    optics->high = bins + 2 * greys;
    optics->slope2 = bins + 3 * greys;
    optics->inverse_slope2 = bins + 4 * greys;
    optics->shot = bins + 5 * greys;
    optics->read = bins + 6 * greys;
    optics->slope2_at = places;
    optics->shot_at = places + exposures;
    optics->read_at = places + 2 * exposures;
    return 1;
}

PyDoc_STRVAR(pass_time_doc, "pass_time(scene, kept, moved, risen)\n--\n\n"
                            "What was seen grows old: `kept` of it is left, the camera has moved by a share of a cell, and\n"
                            "the light has risen by so many bins. scene: see see_frame.");

static PyObject *pass_time_of(PyObject *module, PyObject *arguments)
{
    PyObject *arrays, *result = NULL;
    double kept, moved;
    Py_ssize_t risen;
    Scene scene;
    Held held = {0};
    (void)module;
    if (!PyArg_ParseTuple(arguments, "Oddn", &arrays, &kept, &moved, &risen))
        return NULL;
    if (hold_scene(&held, arrays, &scene)) {
        pass_time(&scene, kept, moved, risen);
        result = Py_NewRef(Py_None);
    }
    release(&held);
    return result;
}

PyDoc_STRVAR(see_frame_doc,
             "see_frame(rules, scene, optics, energy, count, level, gain, averaged, usual_richness, by_cell)\n--\n\n"
             "Take in a frame: (noise_share, usual_richness, guessed, expected, found).\n\n"
             "rules: RULES of scene_belief.py. scene: its arrays mass, energy, precision (bins, 64), seen (bins,), bounds (2,),\n"
             "hidden, tail, richness (2, 64), float64, written. optics: those of `Optics`. energy, count: of Contrast. level:\n"
             "stops, with the drift. gain: linear. averaged: samples of the sensor in a pixel. by_cell: float64 (64,), written.\n"
             "guessed, expected, found: contrast guessed in what was hidden, and in what of that the frame shows, if there\n"
             "was nothing else; and what it shows there. All are 0 if it shows hardly anything new.");

static PyObject *see_into(Held *held, PyObject *const objects[6], Belief *belief, Frame *frame, Told *told)
{
    double *by_cell;
    if (!hold_rules(objects[0], &belief->rules) || !hold_scene(held, objects[1], &belief->scene) ||
        !hold_optics(held, objects[2], &belief->rules, &belief->optics))
        return NULL;
    const Py_ssize_t places = times(ALL_CELLS, (Py_ssize_t)belief->optics.bins);
    if (!(frame->energy = hold_doubles(held, objects[3], places, "energy")) ||
        !(frame->count = hold_doubles(held, objects[4], places, "count")) ||
        !(by_cell = hold_result(held, objects[5], ALL_CELLS, "by_cell")))
        return NULL;
    if (see_frame(&belief->rules, &belief->scene, &belief->optics, frame, by_cell, told))
        return PyErr_NoMemory();
    return Py_BuildValue("ddddd", told->noise_share, told->usual_richness, told->guessed, told->expected, told->found);
}

static PyObject *see_frame_of(PyObject *module, PyObject *arguments)
{
    PyObject *objects[6];
    Belief belief;
    Frame frame;
    Told told = {0};
    Held held = {0};
    (void)module;
    if (!PyArg_ParseTuple(arguments, "OOOOOddddO", &objects[0], &objects[1], &objects[2], &objects[3], &objects[4],
                          &frame.level, &frame.gain, &frame.averaged, &told.usual_richness, &objects[5]))
        return NULL;
    PyObject *result = see_into(&held, objects, &belief, &frame, &told);
    release(&held);
    return result;
}

PyDoc_STRVAR(look_out_doc,
             "look_out(rules, scene, optics, levels, gains, averaged, noise_share, by_cell, light, favours, information,\n"
             "         favoured, revealed)\n--\n\n"
             "What frames are expected to hold, if nothing is hidden, if it continues what is seen, and if it is detached;\n"
             "and the share of it that they would show. Returned: the share of it that is expected to continue.\n\n"
             "levels: float64 (n,), stops, with the drift. gains: linear, (n,). by_cell, light, favours: (64,), pixels, what\n"
             "the lens lets through, and weights, or None. information, favoured, revealed: (3, n), written; favoured: only\n"
             "with favours. The others: see see_frame.");

static PyObject *look_into(Held *held, PyObject *const objects[11], Belief *belief, Outlooks *frames)
{
    enum { RULES, SCENE, OPTICS, LEVELS, GAINS, BY_CELL, LIGHT, FAVOURS, INFORMATION, FAVOURED, REVEALED };
    const int steered = objects[FAVOURS] != Py_None;
    double *information, *revealed, *favoured = NULL, continues;
    if (!hold_rules(objects[RULES], &belief->rules) || !hold_scene(held, objects[SCENE], &belief->scene) ||
        !hold_optics(held, objects[OPTICS], &belief->rules, &belief->optics) ||
        !(frames->levels = hold_doubles(held, objects[LEVELS], -1, "levels")))
        return NULL;
    const Py_ssize_t n = held_numbers(held), results = times(HYPOTHESES, n);
    frames->count = (size_t)n;
    frames->favours = NULL;
    if (!(frames->gains = hold_doubles(held, objects[GAINS], n, "gains")) ||
        !(frames->by_cell = hold_doubles(held, objects[BY_CELL], ALL_CELLS, "by_cell")) ||
        !(frames->light = hold_doubles(held, objects[LIGHT], ALL_CELLS, "light")) ||
        !(information = hold_result(held, objects[INFORMATION], results, "information")) ||
        !(revealed = hold_result(held, objects[REVEALED], results, "revealed")) ||
        (steered && (!(frames->favours = hold_doubles(held, objects[FAVOURS], ALL_CELLS, "favours")) ||
                     !(favoured = hold_result(held, objects[FAVOURED], results, "favoured")))))
        return NULL;
    if (look_out(&belief->rules, &belief->scene, &belief->optics, frames, information, favoured, revealed, &continues))
        return PyErr_NoMemory();
    return PyFloat_FromDouble(continues);
}

static PyObject *look_out_of(PyObject *module, PyObject *arguments)
{
    PyObject *objects[11];
    Belief belief;
    Outlooks frames;
    Held held = {0};
    (void)module;
    if (!PyArg_ParseTuple(arguments, "OOOOOddOOOOOO", &objects[0], &objects[1], &objects[2], &objects[3], &objects[4],
                          &frames.averaged, &frames.noise_share, &objects[5], &objects[6], &objects[7], &objects[8],
                          &objects[9], &objects[10]))
        return NULL;
    PyObject *result = look_into(&held, objects, &belief, &frames);
    release(&held);
    return result;
}

PyMethodDef belief_methods[] = {
    {"pass_time", pass_time_of, METH_VARARGS, pass_time_doc},
    {"see_frame", see_frame_of, METH_VARARGS, see_frame_doc},
    {"look_out", look_out_of, METH_VARARGS, look_out_doc},
    {NULL, NULL, 0, NULL},
};
