/* Publishing messages, for the Python type Publisher. Results are those of its methods; NULL with an exception. */
#ifndef ROBBIE_PUBLISHER_H
#define ROBBIE_PUBLISHER_H

#include "native.h"

PyObject *publisher_publish(struct publisher_object *self, PyObject *message, PyObject *topic);
PyObject *publisher_publish_encoded(struct publisher_object *self, uint64_t declaration, const void *data,
                                    uint64_t size);
PyObject *publisher_hand_over(struct publisher_object *self, struct block_object *block, uint64_t declaration,
                              uint64_t size);
PyObject *publisher_outstanding(struct publisher_object *self);

#endif
