/* The way of a message through the core: the common form of the records PUBLISH, RELEASE, DONE and WAIT_FREED.
 *
 * It does what robbie_mp/bus/core/flow.py and queues.py do, with the same stores in the same order, on the same
 * books. Whatever is not common is left alone before the first store, and Python does it. */
#ifndef ROBBIE_ROUTER_H
#define ROBBIE_ROUTER_H

#include "books.h"

/* A round over the rings, which stops whenever Python must handle a record. The arrays have room for all
 * links. */
struct round {
    struct link **links; /* those that get a turn */
    uint64_t count, next;
    struct link **releasing; /* those of them whose turn comes last */
    uint64_t releasing_count, releasing_next;
    struct link **unfinished; /* their rings have more records than are handled in a turn */
    uint64_t unfinished_count;
    struct link *current; /* NULL: the turn of the next link begins */
    uint64_t left;        /* records of its turn, behind the one that Python handles */
};

struct router {
    struct round round;
    struct books *books;
    uint64_t message_bytes; /* size of the largest valid message */
    uint32_t *claims;       /* room for a reference of every subscription */
    /* Wakes a module. */
    void (*wake)(void *context, struct link *link);
    void *context;
    bool is_special; /* a dead publisher has live messages */
    bool holds_posts; /* more records follow, so that one post may wake a module for all of them */
};

/* Begin a round: find the links whose outbound rings have new records since the last one. */
void begin_round(struct router *router);
/* Give every module with records one turn.
 *
 * Rings that begin with a release come last: a subscriber waits for every message, but a publisher rarely
 * waits for a release.
 *
 * Args:
 *   records_per_turn: most records of one module that are handled in its turn.
 *
 * Returns: a link of which Python must handle the next record, and then call this again; if `round.left` is
 *   UINT64_MAX, its ring is corrupt instead. NULL: the round is over. */
struct link *serve_round(struct router *router, uint64_t records_per_turn);
/* Handle the next records of a module, up to the first that is not common. When all are handled, wake those
 * modules that got messages.
 *
 * Args:
 *   records: how many to handle; `ring_waiting` has said that they are there.
 *
 * Returns: how many were handled. */
uint64_t serve(struct router *router, struct link *link, uint64_t records);
/* Ask the modules to post on a release, or not to, before the core sleeps; see router.py.
 *
 * Returns: whether the rings must be looked at again. */
bool before_sleep(struct books *books);
/* Have a module be woken, for it has been sent records. */
void note_post(struct books *books, struct link *link);
/* Wake the modules that have been sent records, in that order. */
void post(struct router *router);

#endif
