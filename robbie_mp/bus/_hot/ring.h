/* Rings of records between two processes; the same as robbie_mp/bus/transport/ring.py. */
#ifndef ROBBIE_RING_H
#define ROBBIE_RING_H

#include "layout.h"
#include "words.h"
#include <stdbool.h>

/* Where a ring lies: head and records in the writer's segment, the tail in the reader's segment. */
struct ring_place {
    shared_word *head;
    shared_word *records;
    shared_word *tail;
    uint64_t capacity; /* number of records, a power of two */
};

struct ring_writer {
    struct ring_place place;
    uint64_t head;
};

struct ring_reader {
    struct ring_place place;
    uint64_t tail;
    uint64_t looked_up_to; /* records before this one were checked against the head, and may be read at once */
};

struct ring_writer ring_writer_at(struct ring_place place);
/* Records that can be pushed now; none if the reader's tail is one that it cannot have. */
uint64_t ring_room(const struct ring_writer *ring);
/* Append a record of seven words; call `ring_room` first. */
void ring_push(struct ring_writer *ring, const uint64_t record[7]);

struct ring_reader ring_reader_at(struct ring_place place);
/* Number of records that can be read now; more than the capacity: the ring is corrupt. */
uint64_t ring_waiting(const struct ring_reader *ring);
/* Copy the record at the tail; false if it does not carry its own number. Call `ring_waiting` first. */
bool ring_peek(const struct ring_reader *ring, uint64_t record[8]);
/* The first word at the tail, unchecked: there may be no record. */
uint64_t ring_glance(const struct ring_reader *ring);
/* Advance the tail, so that the writer may reuse the record's place. */
void ring_take(struct ring_reader *ring);

/* Rings of single numbers, such as freed blocks. The writer does not check for room: the reader limits how
 * many numbers can be on their way. */
void number_ring_push(struct ring_writer *ring, uint64_t number);
/* The number at an index behind the tail; call `ring_waiting` first, which tells how many there are. */
uint64_t number_ring_at(const struct ring_reader *ring, uint64_t index);
/* Take the first `count` numbers. */
void number_ring_take(struct ring_reader *ring, uint64_t count);

#endif
