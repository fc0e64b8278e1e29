/* The semaphore as C code finds it behind a Python callable. */
#ifndef ROBBIE_WAKEUP_BINDINGS_H
#define ROBBIE_WAKEUP_BINDINGS_H

#define PY_SSIZE_T_CLEAN
#include <Python.h>
#include "wakeup.h"

/* Return the semaphore to which a callable posts, which lives as long as the callable; NULL, without an
 * exception, if it is any other callable. */
struct wakeup *wakeup_of(PyObject *callable);

#endif
