/* The Python types of the core's books. */
#ifndef ROBBIE_BOOKS_BINDINGS_H
#define ROBBIE_BOOKS_BINDINGS_H

#include "native.h"
#include "router.h"
#include "wakeup.h"

/* Numbers in a buffer of Python, such as an array of type 'Q'. */
struct held_numbers {
    PyObject *object; /* NULL: none */
    Py_buffer buffer;
};

struct rows_object {
    PyObject_HEAD
    struct free_rows rows;
};

struct references_object {
    PyObject_HEAD
    struct reference_list list;
    PyObject *books; /* has the places */
};

struct subscription_object {
    PyObject_HEAD
    struct subscription subscription;
};

struct channel_object {
    PyObject_HEAD
    struct channel channel;
    PyObject *subscriptions; /* a tuple */
};

struct link_object {
    PyObject_HEAD
    struct link link;
    PyObject *outbound, *inbound, *freed, *channels, *pushed, *pinned, *wake;
    struct wakeup *wakeup; /* that of `wake`; NULL: `wake` must be called */
    struct held_numbers in_flight, windows;
};

struct slot_object {
    PyObject_HEAD
    struct slot slot;
    PyObject *waiting, *link;
};

struct books_object {
    PyObject_HEAD
    struct books books;
    struct router router;
    struct held_words words;
    struct held_numbers holders;
    PyObject *free_handles, *free_references;
    PyObject *slots;          /* a tuple */
    PyObject *links;          /* a tuple: those that books.links names */
    PyObject *links_in_round; /* a tuple: those of the round; NULL: there is no round */
    uint64_t link_room;       /* of the arrays of links */
    PyObject **subscriptions; /* those that books.subscriptions names */
};

extern PyTypeObject free_rows_type, references_type, subscription_type, channel_type, link_type, slot_type, books_type;

#endif
