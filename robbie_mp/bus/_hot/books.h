/* What the core knows of a run besides its tables in shared memory: free rows, queues, connected modules.
 *
 * The Python of robbie_mp/bus/core works on the same books through the types of books.pxi. Whatever the
 * tables hold (messages, references, counts) is read from there and is not kept here a second time. */
#ifndef ROBBIE_BOOKS_H
#define ROBBIE_BOOKS_H

#include "layout.h"
#include "ring.h"
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#define NO_REFERENCE UINT32_MAX

struct reference_list;

/* A reference's place in a list. A reference waits for a module, or was pushed to it, or is pinned by it; so
 * it is in at most one list. */
struct place_in_list {
    struct reference_list *list; /* NULL: in none */
    uint64_t value;
    uint32_t before, after;
};

/* References in the order in which they were entered, each with a number. */
struct reference_list {
    struct place_in_list *places; /* of all references: those of the books */
    uint64_t references;          /* how many */
    uint64_t count;
    uint32_t first, last;
};

void list_init(struct reference_list *list, struct place_in_list *places, uint64_t references);
/* Forget what is in the list. */
void list_clear(struct reference_list *list);
/* Let no reference name a list that is about to go, in whatever state it is. */
void list_forget(const struct reference_list *list);
bool list_has(const struct reference_list *list, uint64_t reference);
/* Enter a reference at the end; if it is in another list, take it from there. */
void list_append(struct reference_list *list, uint32_t reference, uint64_t value);
/* Take a reference out; returns its value. */
uint64_t list_remove(struct reference_list *list, uint32_t reference);
void list_move_to_front(struct reference_list *list, uint32_t reference);

/* Free rows of a table; the last one is taken next. */
struct free_rows {
    uint32_t *rows;
    uint64_t count;
    uint64_t capacity;
};

/* See Subscription of directory.py. */
struct subscription {
    uint64_t index, at, slot, declaration;
    bool newest_only;
    uint32_t queued; /* NO_REFERENCE: none */
};

/* See Channel of directory.py. */
struct channel {
    uint64_t index, at;
    struct subscription **subscriptions;
    uint64_t subscription_count;
    uint64_t paced_sequence;
    uint32_t paced_reference;
};

/* See Link of members.py. */
struct link {
    void *owner; /* the object of Python that has it */
    uint64_t slot, source, credit, awaited_freed;
    uint64_t wanted_release; /* what its word says */
    bool ready, has_ended, paces;
    struct ring_reader *outbound;
    struct ring_writer *inbound, *freed;
    struct channel *channels[DECLARATION_COUNT]; /* by declaration; NULL: it has declared no such channel */
    struct reference_list *pushed, *pinned;
    uint64_t *in_flight, *windows; /* by the slot of the publisher */
    bool is_to_post;
    struct link *to_post_next;
    uint64_t head_seen; /* head of its outbound ring when a round last looked at it */
    bool is_in_round;
};

/* See Slot of members.py. */
struct slot {
    uint64_t index, at, queue_messages, queue_bytes, waiting_bytes;
    struct reference_list *waiting;
    struct link *link; /* NULL: it is not connected */
    bool yields;
    bool is_outdated;
    struct slot *outdated_next;
};

struct books {
    shared_word *words; /* the core's segment */
    /* Where its tables begin, and how many rows they have. */
    shared_word *handle_rows, *reference_rows;
    uint64_t slot_count, subscription_count, handle_count, reference_count;
    struct free_rows *free_handles, *free_references;
    uint64_t *holders; /* of each message: how many references to it are left */
    struct place_in_list *places;
    struct slot **slots;
    struct link **links; /* all that are connected */
    uint64_t link_count;
    struct subscription **subscriptions; /* by row; NULL: not opened yet */
    struct slot *outdated_first, *outdated_last; /* modules whose figures must be written again */
    struct link *to_post_first, *to_post_last;   /* modules that must be woken */
    bool is_wanting; /* some module may have been asked to post when it releases */
};

/* Note that the queue of a module, or the messages it has, have changed. */
void outdate(struct books *books, struct slot *slot);
/* Write the length of the queues, and the number of messages that modules have, for observers. */
void write_figures(struct books *books);
bool somebody_waits(const struct books *books);

#endif
