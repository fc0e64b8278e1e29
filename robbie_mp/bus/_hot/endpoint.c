/* What a module pushes and takes for a message. */
#include "endpoint.h"

bool endpoint_may_publish(const struct endpoint *endpoint)
{
    return ring_room(endpoint->outbound) > endpoint->reserve;
}

void endpoint_publish(struct endpoint *endpoint, uint64_t declaration, const struct placed_message *message,
                      uint64_t stamp_ns)
{
    const uint64_t source = endpoint->source | message->segment << 16;
    ring_push(endpoint->outbound, (uint64_t[7]){OUTBOUND_PUBLISH, declaration, source, message->offset,
                                                message->size, stamp_ns, message->block});
}

bool endpoint_return(struct endpoint *endpoint, uint64_t kind, uint64_t reference, uint64_t sequence)
{
    if (ring_room(endpoint->outbound) == 0)
        return false;
    ring_push(endpoint->outbound, (uint64_t[7]){kind, reference, sequence, 0, 0, 0, 0});
    return true;
}

bool endpoint_is_wanted(const struct endpoint *endpoint)
{
    /* If a module waits for released messages, the core sets this word before it sleeps, and then looks at the
     * ring once more. So at least one of the two sees the other's store. */
    fence();
    const uint64_t wanted = load(endpoint->want_release);
    return wanted != 0 && endpoint->inbound->tail >= wanted;
}

enum found endpoint_look(struct endpoint *endpoint, struct delivery *delivery)
{
    struct ring_reader *ring = endpoint->inbound;
    if (ring->tail == ring->looked_up_to) {
        const uint64_t waiting = ring_waiting(ring);
        if (waiting == 0)
            return FOUND_NOTHING;
        if (waiting > ring->place.capacity)
            return FOUND_OTHER;
        ring->looked_up_to = ring->tail + waiting;
    }
    uint64_t record[RECORD_WORDS];
    if (!ring_peek(ring, record) || (record[0] & KIND_MASK) != INBOUND_DELIVER)
        return FOUND_OTHER;
    *delivery = (struct delivery){
        .declaration = record[0] >> DECLARATION_SHIFT & DECLARATION_MASK,
        .channel = record[0] >> CHANNEL_SHIFT,
        .reference = record[1],
        .sequence = record[2],
        .source = record[3],
        .offset = record[4],
        .size = record[5],
        .stamp_ns = record[6],
    };
    return FOUND_DELIVERY;
}
