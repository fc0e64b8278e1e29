/* Taking and handling messages, for the loop of a module. */
#ifndef ROBBIE_SUBSCRIBER_H
#define ROBBIE_SUBSCRIBER_H

#include "native.h"
#include <stdbool.h>

enum handled { HANDLED_ONE, HANDLED_NONE, HANDLED_NOT_MINE, HANDLED_WITH_ERROR };

/* Take and handle the next message for an Inbox. HANDLED_NOT_MINE: Python must do it; HANDLED_WITH_ERROR: an
 * exception is set. */
enum handled subscriber_handle_next(struct subscriber_object *self, PyObject *inbox);

/* Record an event of the loop, such as EVENT_TICK, that is about to happen. */
void subscriber_record(const struct subscriber_object *self, uint64_t event, uint64_t time_ns);

/* Use the time in which there is nothing to do for the history. */
void subscriber_prepare_history(const struct subscriber_object *self);

/* Check that Python code that has run in between has left it usable; 1, or -1 with an exception. */
int subscriber_check(const struct subscriber_object *self);

#endif
