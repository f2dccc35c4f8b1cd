/* What Python sees of this library, by file. */
#ifndef AUTOEXPOSE_BINDINGS_H
#define AUTOEXPOSE_BINDINGS_H

#define PY_SSIZE_T_CLEAN
#include <Python.h>

extern PyMethodDef gradient_methods[], picture_methods[], split_methods[], belief_methods[], plan_methods[];

/* Names of the instruction sets of gradient.h. */
PyObject *set_names(void);

#endif
