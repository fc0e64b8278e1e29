/* Messages in other modules' memory, and what is still in use of them. */
#ifndef ROBBIE_PINS_H
#define ROBBIE_PINS_H

#include "endpoint_bindings.h"
#include "native.h"

/* A number in a list that a finalizer can lengthen: it takes no memory then. */
struct reference_node {
    struct reference_node *next;
    uint64_t reference;
};

/* The bytes of a message. Every view of them, however derived, refers to this object; so it is deallocated when
 * the last one is gone, in whatever thread that happens. */
struct message_bytes_object {
    PyObject_HEAD
    struct mapped_segment_object *segment;
    struct unreferenced_object *unreferenced;
    struct reference_node *node; /* to be appended to `unreferenced` at the end; NULL: nobody waits for that */
    uint8_t *first;
    uint64_t size;
};

/* What is pinned of one incarnation of a publisher. */
struct pinned_publisher {
    uint64_t publisher;
    uint64_t messages;
    uint64_t bytes;
};

extern PyTypeObject message_bytes_type;

/* Return the bytes of a message; NULL with an exception. They must lie in the segment. */
struct message_bytes_object *new_message_bytes(struct mapped_segment_object *segment, uint64_t start, uint64_t size);
/* From now on, tell when the last view is gone; 0, or -1 with an exception. */
int keep_message_bytes(struct message_bytes_object *self, struct unreferenced_object *unreferenced, uint64_t reference);

struct reference_node *new_node(uint64_t reference);
void append_node(struct unreferenced_object *self, struct reference_node *node);
/* Take the first of the references, of which there must be one. */
uint64_t pop_reference(struct unreferenced_object *self);

/* Whether the limits of pinned messages and bytes of a publisher leave room for another one. */
bool pins_have_room(const struct pins_object *self, const struct delivery *delivery, uint64_t free_bytes);
/* Pin a message, and count it; 0, or -1 with an exception. */
int add_pin(struct pins_object *self, const struct delivery *delivery, PyTypeObject *delivery_type);
/* The same together with an object that is to live as long. */
int pin(struct pins_object *self, PyObject *delivery, PyObject *with, uint64_t reference, uint64_t source,
        uint64_t size);
/* Return the delivery of a message that is no longer pinned, and count that; NULL with an exception. */
PyObject *remove_pin(struct pins_object *self, uint64_t reference);

#endif
