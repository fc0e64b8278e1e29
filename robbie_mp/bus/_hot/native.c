/* The Python module robbie_mp.bus._hot.native: all that is written in C. */
#include "native.h"

int hold_words(struct held_words *held, PyObject *object, bool writable)
{
    held->words = NULL;
    /* A memoryview of its own: the one that Python uses can then be released, as for a forked process. */
    PyObject *view = PyMemoryView_FromObject(object);
    if (view == NULL)
        return -1;
    int failed = PyObject_GetBuffer(view, &held->buffer, writable ? PyBUF_WRITABLE : PyBUF_SIMPLE);
    Py_DECREF(view);
    if (failed)
        return -1;
    if ((uintptr_t)held->buffer.buf % sizeof(shared_word) != 0 || held->buffer.len % sizeof(shared_word) != 0) {
        PyBuffer_Release(&held->buffer);
        PyErr_SetString(PyExc_ValueError, "words must lie at multiples of 8 bytes");
        return -1;
    }
    held->words = held->buffer.buf;
    held->count = held->buffer.len / (Py_ssize_t)sizeof(shared_word);
    return 0;
}

void release_words(struct held_words *held)
{
    if (held->words == NULL)
        return;
    held->words = NULL;
    PyBuffer_Release(&held->buffer);
}

#ifndef ROBBIE_SOURCES
#define ROBBIE_SOURCES "" /* a test build */
#endif

static int add_constants(PyObject *module)
{
    if (PyModule_AddIntMacro(module, LAYOUT_VERSION) != 0)
        return -1;
    return PyModule_AddStringConstant(module, "SOURCES", ROBBIE_SOURCES);
}

void raise_forked_process(void)
{
    PyObject *forks = PyImport_ImportModule("robbie_mp.base.linux.forks");
    PyObject *error = forks == NULL ? NULL : PyObject_GetAttrString(forks, "ForkedProcess");
    PyObject *raised = error == NULL ? NULL : PyObject_CallNoArgs(error);
    if (raised != NULL)
        PyErr_SetObject(error, raised);
    Py_XDECREF(raised);
    Py_XDECREF(error);
    Py_XDECREF(forks);
}

static int add_all(PyObject *module)
{
#ifdef ROBBIE_FUSE
    if (add_fuse_types(module) != 0)
        return -1;
#endif
    int (*const add[])(PyObject *) = {
        add_constants,
        add_ring_types,
        add_wakeup_types,
        add_books_types,
        add_message_types,
        add_message_layout_type,
        add_lock_type,
        add_endpoint_type,
        add_block_types,
        add_publisher_type,
        add_pin_types,
        add_history_type,
        add_subscriber_type,
        add_loop_types,
    };
    for (size_t index = 0; index < sizeof(add) / sizeof(add[0]); index++)
        if (add[index](module) != 0)
            return -1;
    return 0;
}

static PyModuleDef_Slot slots[] = {
    {Py_mod_exec, add_all},
    {0, NULL},
};

static struct PyModuleDef definition = {
    PyModuleDef_HEAD_INIT,
    .m_name = "robbie_mp.bus._hot.native",
    .m_doc = "The hot path in C; what it does is described by the Python of the same names.",
    .m_size = 0,
    .m_slots = slots,
};

PyMODINIT_FUNC PyInit_native(void)
{
    return PyModuleDef_Init(&definition);
}
