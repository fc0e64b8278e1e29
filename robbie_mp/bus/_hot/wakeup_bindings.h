/* The wake-up as C code finds it behind a Python callable. */
#ifndef ROBBIE_WAKEUP_BINDINGS_H
#define ROBBIE_WAKEUP_BINDINGS_H

#define PY_SSIZE_T_CLEAN
#include <Python.h>
#include "wakeup.h"

/* Return the wake-up to which a callable posts, which lives as long as the callable; NULL, without an exception,
 * if it is any other callable. */
struct wakeup *wakeup_of(PyObject *callable);

/* Wait for a post and take all posts: 1; 0 after the time-out or a signal; -1 with an exception, such as that
 * of a signal's handler. Other threads run meanwhile. */
int wait_for_post(struct wakeup *wakeup, int64_t timeout_ns);
/* Wait for a post without the GIL and take all posts; 0, or the error's number as of `wakeup_wait`. */
int sleep_until_post(struct wakeup *wakeup, int64_t timeout_ns);

#endif
