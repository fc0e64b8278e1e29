/* Two threads use rings, and memory of their own that only the rings' order protects.
 *
 *     ring_race records|numbers|blocks COUNT
 *
 * Under ThreadSanitizer, a fence that is missing shows as a race on that memory. It also checks that every
 * record arrives, once, in order and whole. */
#include "ring.h"
#include <pthread.h>
#include <sched.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

enum { CAPACITY = 16 };

static shared_word head, tail, freed_head, freed_tail;
static shared_word records[CAPACITY * RECORD_WORDS], freed[CAPACITY];
static uint64_t payload[CAPACITY]; /* plain memory */
static uint64_t count;

static const struct ring_place record_place = {&head, records, &tail, CAPACITY};
static const struct ring_place freed_place = {&freed_head, freed, &freed_tail, CAPACITY};

static void check(bool is_right, const char *what)
{
    if (is_right)
        return;
    fprintf(stderr, "wrong: %s\n", what);
    exit(1);
}

static void push(struct ring_writer *ring, uint64_t number, uint64_t block)
{
    const uint64_t record[7] = {number, block, ~number, number, number, number, number};
    while (ring_room(ring) == 0)
        sched_yield();
    payload[block] = number;
    ring_push(ring, record);
}

static uint64_t wait_for(const struct ring_reader *ring)
{
    uint64_t waiting;
    while ((waiting = ring_waiting(ring)) == 0)
        sched_yield();
    check(waiting <= CAPACITY, "the ring holds more than it can");
    return waiting;
}

/* Take the next record; return its block. */
static uint64_t pull(struct ring_reader *ring, uint64_t number)
{
    uint64_t record[RECORD_WORDS];
    wait_for(ring);
    check(ring_peek(ring, record), "a record does not carry its own number");
    check(record[0] == number && record[2] == ~number && record[6] == number, "a record out of order");
    check(payload[record[1]] == number, "memory that was used again before its record was taken");
    return record[1];
}

/* Memory by the record's place: full rings protect it. */
static void *write_records(void *unused)
{
    begin_fences();
    struct ring_writer ring = ring_writer_at(record_place);
    for (uint64_t number = 0; number < count; number++)
        push(&ring, number, number % CAPACITY);
    end_fences();
    return unused;
}

static void *read_records(void *unused)
{
    begin_fences();
    struct ring_reader ring = ring_reader_at(record_place);
    for (uint64_t number = 0; number < count; number++) {
        pull(&ring, number);
        ring_take(&ring);
    }
    end_fences();
    return unused;
}

/* The same with numbers, whose ring checks no room itself. */
static void *write_numbers(void *unused)
{
    begin_fences();
    struct ring_writer ring = ring_writer_at(freed_place);
    for (uint64_t number = 0; number < count; number++) {
        while (ring.head - load(&freed_tail) == CAPACITY)
            sched_yield();
        fence_loads();
        payload[number % CAPACITY] = number;
        number_ring_push(&ring, number);
    }
    end_fences();
    return unused;
}

static void *read_numbers(void *unused)
{
    begin_fences();
    struct ring_reader ring = ring_reader_at(freed_place);
    uint64_t next = 0;
    while (next < count) {
        uint64_t waiting = wait_for(&ring);
        for (uint64_t index = 0; index < waiting; index++, next++) {
            check(number_ring_at(&ring, index) == next, "a number out of order");
            check(payload[next % CAPACITY] == next, "memory that was used again too early");
        }
        number_ring_take(&ring, waiting);
    }
    end_fences();
    return unused;
}

/* As a publisher and the core do it: blocks go out with records, and come back as numbers. */
static void *write_blocks(void *unused)
{
    begin_fences();
    struct ring_writer out = ring_writer_at(record_place);
    struct ring_reader back = ring_reader_at(freed_place);
    uint64_t blocks[CAPACITY], free_blocks = CAPACITY;
    for (uint64_t block = 0; block < CAPACITY; block++)
        blocks[block] = block;
    for (uint64_t number = 0; number < count; number++) {
        if (free_blocks == 0) {
            free_blocks = wait_for(&back);
            for (uint64_t index = 0; index < free_blocks; index++)
                blocks[index] = number_ring_at(&back, index);
            number_ring_take(&back, free_blocks);
        }
        push(&out, number, blocks[--free_blocks]);
    }
    end_fences();
    return unused;
}

static void *read_blocks(void *unused)
{
    begin_fences();
    struct ring_reader in = ring_reader_at(record_place);
    struct ring_writer back = ring_writer_at(freed_place);
    for (uint64_t number = 0; number < count; number++) {
        uint64_t block = pull(&in, number);
        ring_take(&in);
        check(payload[block] == number, "a block that was used again before it was given back");
        number_ring_push(&back, block);
    }
    end_fences();
    return unused;
}

int main(int argc, char **argv)
{
    static const struct {
        const char *name;
        void *(*write)(void *), *(*read)(void *);
    } pairs[] = {
        {"records", write_records, read_records},
        {"numbers", write_numbers, read_numbers},
        {"blocks", write_blocks, read_blocks},
    };
    check(argc == 3, "usage: ring_race records|numbers|blocks COUNT");
    count = strtoull(argv[2], NULL, 10);
    for (size_t index = 0; index < sizeof pairs / sizeof *pairs; index++) {
        if (strcmp(argv[1], pairs[index].name) != 0)
            continue;
        pthread_t writer, reader;
        check(pthread_create(&writer, NULL, pairs[index].write, NULL) == 0, "no thread");
        check(pthread_create(&reader, NULL, pairs[index].read, NULL) == 0, "no thread");
        pthread_join(writer, NULL);
        pthread_join(reader, NULL);
        printf("%s: %llu records\n", argv[1], (unsigned long long)count);
        return 0;
    }
    check(false, "an unknown pair of threads");
}
