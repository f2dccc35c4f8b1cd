/* belief.h, hidden.h and outlook.h for Python. */
#include "arguments.h"
#include "belief/belief.h"
#include "belief/hidden.h"
#include "belief/outlook.h"
#include "bindings.h"

/* Of a call; `rules`, `scene` and `optics` are tuples. */
typedef struct {
    Rules rules;
    Scene scene;
    Optics optics;
} Belief;

static int hold_rules(PyObject *object, Rules *rules)
{
    return PyArg_ParseTuple(object, "dddddd(dd)dddd", &rules->lowest, &rules->bin, &rules->renewed, &rules->unsure,
                            &rules->least_look, &rules->longest_tail, &rules->detached[0], &rules->detached[1],
                            &rules->detached_tail, &rules->half_detached_tail, &rules->neighbours[0],
                            &rules->neighbours[1]);
}

static int hold_scene(Held *held, PyObject *object, Scene *scene)
{
    PyObject *mass, *energy, *precision, *seen, *bounds, *hidden, *tail, *richness;
    if (!PyArg_ParseTuple(object, "OOOOOOOOd", &mass, &energy, &precision, &seen, &bounds, &hidden, &tail, &richness,
                          &scene->usual_richness) ||
        !(scene->seen = hold_result(held, seen, -1, "seen")))
        return 0;
    const Py_ssize_t bins = held_numbers(held), places = times(ALL_CELLS, bins), sides = SIDES * ALL_CELLS;
    scene->bins = (size_t)bins;
    return (scene->mass = (void *)hold_result(held, mass, places, "mass")) &&
           (scene->energy = (void *)hold_result(held, energy, places, "energy")) &&
           (scene->precision = (void *)hold_result(held, precision, places, "precision")) &&
           (scene->bounds = hold_result(held, bounds, SIDES, "bounds")) &&
           (scene->hidden = (void *)hold_result(held, hidden, sides, "hidden")) &&
           (scene->tail = (void *)hold_result(held, tail, sides, "tail")) &&
           (scene->richness = (void *)hold_result(held, richness, sides, "richness"));
}

static int hold_optics(Held *held, PyObject *object, const Rules *rules, Optics *optics)
{
    enum { READABLE, LOW, HIGH, SLOPE2, INVERSE_SLOPE2, SHOT, READ, BY_BIN };
    enum { SLOPE2_AT, SHOT_AT, READ_AT, BY_PLACE };
    PyObject *of_bins, *of_places;
    const double *bins, *places;
    if (!PyArg_ParseTuple(object, "OOnd", &of_bins, &of_places, &optics->first, &optics->step) ||
        !(bins = hold_doubles(held, of_bins, -1, "by_bin")))
        return 0;
    const size_t greys = optics->bins = (size_t)held_numbers(held) / BY_BIN;
    if (!(places = hold_doubles(held, of_places, -1, "by_exposure")))
        return 0;
    const size_t exposures = optics->places = (size_t)held_numbers(held) / BY_PLACE;
    if (greys < 3 || !exposures || !(optics->step > 0.0) || !(SAMPLES * optics->step <= rules->bin)) {
        PyErr_SetString(PyExc_ValueError, "optics must have 3 bins or more, and 4 log exposures in a bin of radiance");
        return 0;
    }
    optics->readable = bins + READABLE * greys;
    optics->low = bins + LOW * greys;
    optics->high = bins + HIGH * greys;
    optics->slope2 = bins + SLOPE2 * greys;
    optics->inverse_slope2 = bins + INVERSE_SLOPE2 * greys;
    optics->shot = bins + SHOT * greys;
    optics->read = bins + READ * greys;
    optics->slope2_at = places + SLOPE2_AT * exposures;
    optics->shot_at = places + SHOT_AT * exposures;
    optics->read_at = places + READ_AT * exposures;
    return 1;
}

static int hold_belief(Held *held, PyObject *rules, PyObject *scene, PyObject *optics, Belief *belief)
{
    return hold_rules(rules, &belief->rules) && hold_scene(held, scene, &belief->scene) &&
           hold_optics(held, optics, &belief->rules, &belief->optics);
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
             "see_frame(rules, scene, optics, energy, count, level, gain, averaged, by_cell)\n--\n\n"
             "Take in a frame: (noise_share, usual_richness, guessed, expected, found).\n\n"
             "rules: RULES of scene_belief.py. scene: its arrays mass, energy, precision (bins, 64), seen (bins,), bounds (2,),\n"
             "hidden, tail, richness (2, 64), float64, written; usual_richness. optics: those of `Optics`. energy, count: of Contrast. level:\n"
             "stops, with the drift. gain: linear. averaged: samples of the sensor in a pixel. by_cell: float64 (64,), written.\n"
             "guessed, expected, found: contrast guessed in what was hidden, and in what of that the frame shows, if there\n"
             "was nothing else; and what it shows there. The last two are 0 if it shows hardly anything new.");

static PyObject *see_frame_of(PyObject *module, PyObject *arguments)
{
    PyObject *rules, *scene, *optics, *energy, *count, *written, *result = NULL;
    double *by_cell;
    Belief belief;
    Frame frame;
    Told told = {0};
    Held held = {0};
    (void)module;
    if (!PyArg_ParseTuple(arguments, "OOOOOdddO", &rules, &scene, &optics, &energy, &count, &frame.level, &frame.gain,
                          &frame.averaged, &written))
        return NULL;
    if (hold_belief(&held, rules, scene, optics, &belief) &&
        (frame.energy = hold_doubles(&held, energy, times(ALL_CELLS, (Py_ssize_t)belief.optics.bins), "energy")) &&
        (frame.count = hold_doubles(&held, count, times(ALL_CELLS, (Py_ssize_t)belief.optics.bins), "count")) &&
        (by_cell = hold_result(&held, written, ALL_CELLS, "by_cell")))
        result = see_frame(&belief.rules, &belief.scene, &belief.optics, &frame, by_cell, &told)
                     ? PyErr_NoMemory()
                     : Py_BuildValue("ddddd", told.noise_share, belief.scene.usual_richness, told.guessed, told.expected,
                                     told.found);
    release(&held);
    return result;
}

PyDoc_STRVAR(look_out_doc,
             "look_out(rules, scene, optics, levels, gains, averaged, noise_share, by_cell, light, favours, information,\n"
             "         favoured, revealed)\n--\n\n"
             "What frames are expected to hold, if nothing is hidden, if it continues what is seen, and if it is detached so far;\n"
             "and the share of it that they would show. Returned: the share of it that is expected to continue.\n\n"
             "levels: float64 (n,), stops, with the drift. gains: linear, (n,). by_cell, light, favours: (64,), pixels, what\n"
             "the lens lets through, and weights, or None. information, favoured, revealed: (4, n), written; favoured: only\n"
             "with favours. The others: see see_frame.");

static PyObject *look_out_of(PyObject *module, PyObject *arguments)
{
    PyObject *rules, *scene, *optics, *levels, *gains, *by_cell, *light, *favours, *informed, *favoured, *revealed;
    double *information, *as_favoured = NULL, *shown, continues;
    Belief belief;
    Outlooks frames = {0};
    Held held = {0};
    (void)module;
    if (!PyArg_ParseTuple(arguments, "OOOOOddOOOOOO", &rules, &scene, &optics, &levels, &gains, &frames.averaged,
                          &frames.noise_share, &by_cell, &light, &favours, &informed, &favoured, &revealed))
        return NULL;
    int fits = hold_belief(&held, rules, scene, optics, &belief) &&
               (frames.levels = hold_doubles(&held, levels, -1, "levels"));
    const Py_ssize_t n = fits ? held_numbers(&held) : 0;
    frames.count = (size_t)n;
    fits = fits && (frames.gains = hold_doubles(&held, gains, n, "gains")) &&
           (frames.by_cell = hold_doubles(&held, by_cell, ALL_CELLS, "by_cell")) &&
           (frames.light = hold_doubles(&held, light, ALL_CELLS, "light")) &&
           (information = hold_result(&held, informed, times(HYPOTHESES, n), "information")) &&
           (shown = hold_result(&held, revealed, times(HYPOTHESES, n), "revealed")) &&
           (favours == Py_None ||
            ((frames.favours = hold_doubles(&held, favours, ALL_CELLS, "favours")) &&
             (as_favoured = hold_result(&held, favoured, times(HYPOTHESES, n), "favoured"))));
    PyObject *result = NULL;
    if (fits)
        result = look_out(&belief.rules, &belief.scene, &belief.optics, &frames, information, as_favoured, shown, &continues)
                     ? PyErr_NoMemory()
                     : PyFloat_FromDouble(continues);
    release(&held);
    return result;
}

PyDoc_STRVAR(sum_light_doc,
             "sum_light(rules, scene, pixels, contrast, guessed, guessed_contrast)\n--\n\n"
             "Where the light of the whole picture lies: what was seen, and, in the mean over the guesses, what is hidden, if\n"
             "there is something.\n\n"
             "The last four: float64 (bins,), written. The others: see see_frame.");

static PyObject *sum_light_of(PyObject *module, PyObject *arguments)
{
    PyObject *of_rules, *of_scene, *known, *known_contrast, *hidden, *hidden_contrast, *result = NULL;
    double *pixels, *contrast, *guessed, *guessed_contrast;
    Rules rules;
    Scene scene;
    Held held = {0};
    (void)module;
    if (!PyArg_ParseTuple(arguments, "OOOOOO", &of_rules, &of_scene, &known, &known_contrast, &hidden, &hidden_contrast))
        return NULL;
    if (hold_rules(of_rules, &rules) && hold_scene(&held, of_scene, &scene) &&
        (pixels = hold_result(&held, known, (Py_ssize_t)scene.bins, "pixels")) &&
        (contrast = hold_result(&held, known_contrast, (Py_ssize_t)scene.bins, "contrast")) &&
        (guessed = hold_result(&held, hidden, (Py_ssize_t)scene.bins, "guessed")) &&
        (guessed_contrast = hold_result(&held, hidden_contrast, (Py_ssize_t)scene.bins, "guessed_contrast")))
        result = sum_light(&rules, &scene, pixels, contrast, guessed, guessed_contrast) ? PyErr_NoMemory()
                                                                                        : Py_NewRef(Py_None);
    release(&held);
    return result;
}

PyMethodDef belief_methods[] = {
    {"pass_time", pass_time_of, METH_VARARGS, pass_time_doc},
    {"see_frame", see_frame_of, METH_VARARGS, see_frame_doc},
    {"look_out", look_out_of, METH_VARARGS, look_out_doc},
    {"sum_light", sum_light_of, METH_VARARGS, sum_light_doc},
    {NULL, NULL, 0, NULL},
};
