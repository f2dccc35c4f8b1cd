/* The functions of all files as one module. */
#include "bindings.h"

static struct PyModuleDef definition = {
    .m_base = PyModuleDef_HEAD_INIT,
    .m_name = "_native",
    .m_doc = "What control computes of pictures and exposures, each in one call.",
    .m_size = -1,
};

PyMODINIT_FUNC PyInit__native(void)
{
    PyObject *module = PyModule_Create(&definition), *names = module ? set_names() : NULL;
    if (!names || PyModule_AddFunctions(module, gradient_methods) < 0 ||
        PyModule_AddFunctions(module, picture_methods) < 0 || PyModule_AddFunctions(module, split_methods) < 0 ||
        PyModule_AddFunctions(module, belief_methods) < 0 || PyModule_AddFunctions(module, plan_methods) < 0 ||
        PyModule_AddObjectRef(module, "INSTRUCTION_SETS", names) < 0)
        Py_CLEAR(module);
    Py_XDECREF(names);
    return module;
}
