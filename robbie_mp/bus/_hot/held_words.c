/* Words that Python memory holds, for the bindings. */
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
