#include "ring.h"

struct ring_writer ring_writer_at(struct ring_place place)
{
    return (struct ring_writer){place, load(place.head)};
}

uint64_t ring_room(const struct ring_writer *ring)
{
    uint64_t tail = load(ring->place.tail);
    fence_loads(); /* places that the reader has left are written after it has read them */
    if (tail > ring->head || ring->head - tail > ring->place.capacity)
        return 0;
    return ring->place.capacity - (ring->head - tail);
}

void ring_push(struct ring_writer *ring, const uint64_t record[7])
{
    shared_word *at = ring->place.records + (ring->head & (ring->place.capacity - 1)) * RECORD_WORDS;
    for (int word = 0; word < 7; word++)
        store(at + word, record[word]);
    store(at + 7, ring->head + 1);
    fence_stores(); /* the head tells the reader that the record is there */
    store(ring->place.head, ring->head + 1);
    ring->head++;
}

struct ring_reader ring_reader_at(struct ring_place place)
{
    uint64_t tail = load(place.tail);
    return (struct ring_reader){place, tail, tail};
}

uint64_t ring_waiting(const struct ring_reader *ring)
{
    uint64_t waiting = load(ring->place.head) - ring->tail;
    fence_loads(); /* the records are read after the head */
    return waiting;
}

bool ring_peek(const struct ring_reader *ring, uint64_t record[8])
{
    const shared_word *at = ring->place.records + (ring->tail & (ring->place.capacity - 1)) * RECORD_WORDS;
    for (int word = 0; word < RECORD_WORDS; word++)
        record[word] = load(at + word);
    return record[7] == ring->tail + 1;
}

uint64_t ring_glance(const struct ring_reader *ring)
{
    return load(ring->place.records + (ring->tail & (ring->place.capacity - 1)) * RECORD_WORDS);
}

void ring_take(struct ring_reader *ring)
{
    fence(); /* the record was read before the writer may use its place again */
    store(ring->place.tail, ring->tail + 1);
    ring->tail++;
}

void number_ring_push(struct ring_writer *ring, uint64_t number)
{
    store(ring->place.records + (ring->head & (ring->place.capacity - 1)), number);
    fence_stores();
    store(ring->place.head, ring->head + 1);
    ring->head++;
}

uint64_t number_ring_at(const struct ring_reader *ring, uint64_t index)
{
    return load(ring->place.records + ((ring->tail + index) & (ring->place.capacity - 1)));
}

void number_ring_take(struct ring_reader *ring, uint64_t count)
{
    fence();
    store(ring->place.tail, ring->tail + count);
    ring->tail += count;
}
