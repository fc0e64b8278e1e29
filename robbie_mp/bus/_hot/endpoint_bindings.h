/* A module's end of the bus as a Python object, for the bindings that publish and handle messages. */
#ifndef ROBBIE_ENDPOINT_BINDINGS_H
#define ROBBIE_ENDPOINT_BINDINGS_H

#include "native.h"
#include "endpoint.h"
#include "lock.h"

/* Whether C may push and take now. If not, Python waits for the lock, pushes the backlog, or says what is wrong. */
bool endpoint_is_mine(const struct endpoint_object *self);
/* Wake the core; 0, or -1 with an exception set. */
int endpoint_wake_core(struct endpoint_object *self);
/* Push RELEASE or DONE, and wake the core if it waits for that; 1, 0 if this is not mine, -1 with an exception. */
int endpoint_give_back(struct endpoint_object *self, uint64_t kind, uint64_t reference, uint64_t sequence);
/* Return a Delivery of robbie_mp/bus/transport/records.py. */
PyObject *new_delivery(PyTypeObject *type, const struct delivery *delivery);

#endif
