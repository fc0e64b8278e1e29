/* A module's end of the bus; the same as robbie_mp/bus/transport/endpoint.py does in its common form. */
#ifndef ROBBIE_ENDPOINT_H
#define ROBBIE_ENDPOINT_H

#include "ring.h"

struct endpoint {
    struct ring_writer *outbound;
    struct ring_reader *inbound;
    struct ring_reader *freed;
    const shared_word *want_release; /* the core's word: how many taken records it waits for; 0: none */
    uint64_t source;                 /* names this incarnation's first data segment */
    uint64_t reserve;                /* room in the outbound ring that publishing leaves for releases */
};

/* Where a message lies: in which data segment, and as which block. */
struct placed_message {
    uint64_t segment;
    uint64_t offset;
    uint64_t size;
    uint64_t block;
};

/* A handle that the core delivered. */
struct delivery {
    uint64_t declaration;
    uint64_t channel;
    uint64_t reference;
    uint64_t sequence;
    uint64_t source;
    uint64_t offset;
    uint64_t size;
    uint64_t stamp_ns;
};

enum found { FOUND_NOTHING, FOUND_DELIVERY, FOUND_OTHER /* another record, or a ring that is corrupt */ };

/* Whether there is room for a message. */
bool endpoint_may_publish(const struct endpoint *endpoint);
/* Push a message's record; call `endpoint_may_publish` first, and wake the core then. */
void endpoint_publish(struct endpoint *endpoint, uint64_t declaration, const struct placed_message *message,
                      uint64_t stamp_ns);
/* Push RELEASE or DONE; false, without a store, if there is no room. */
bool endpoint_return(struct endpoint *endpoint, uint64_t kind, uint64_t reference, uint64_t sequence);
/* Whether the core is to be woken because of what has been returned. */
bool endpoint_is_wanted(const struct endpoint *endpoint);
/* Look at the next inbound record without taking it. */
enum found endpoint_look(struct endpoint *endpoint, struct delivery *delivery);

#endif
