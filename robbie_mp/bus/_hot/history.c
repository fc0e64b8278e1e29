/* What a module has handled; the same as HistoryWriter in robbie_mp/bus/transport/history.py. */
#define _DEFAULT_SOURCE /* madvise */
#include "history.h"
#include <string.h>
#include <sys/mman.h>
#include <sys/statvfs.h>

#ifndef MADV_POPULATE_WRITE
#define MADV_POPULATE_WRITE 23 /* Linux 5.14 */
#endif

/* As in history.py. */
enum {
    HEAD_BYTES = HISTORY_RECORD_WORDS * 8,
    LARGEST_SHARE = 16,
    LARGEST_KEY_SHARE = 4,
    LARGEST_PUBLISHED_SHARE = 256,
    GROWTH_BYTES = 1 << 16,
    ROOM_FACTOR = 16,
};
static const char shared_memory[] = "/dev/shm";

static shared_word *word_at(const struct history_object *self, uint64_t number)
{
    return self->words.words + HISTORY_RING + number % self->capacity / 8;
}

/* Whether there is so much free memory that the ring may grow. */
static bool has_room(uint64_t capacity)
{
    struct statvfs found;
    return statvfs(shared_memory, &found) == 0 && (uint64_t)found.f_bavail * found.f_frsize >= ROOM_FACTOR * capacity;
}

/* Give the ring so much more memory, and touch it: a write to a new page would take 3 us, in one of 30 messages.
 * Nothing changes if there is no room, or if the oldest records have been overwritten. */
static void grow(struct history_object *self, uint64_t bytes)
{
    shared_word *words = self->words.words;
    const uint64_t left = self->most_capacity - self->capacity;
    bytes = (bytes + GROWTH_BYTES - 1) / GROWTH_BYTES * GROWTH_BYTES;
    if (bytes > left)
        bytes = left;
    if (bytes == 0 || load(words + HISTORY_TAIL) != 0 || !has_room(self->capacity + bytes))
        return;
    char *const begin = (char *)(words + HISTORY_RING) + self->capacity;
    if (madvise(begin, bytes, MADV_POPULATE_WRITE) != 0)
        return;
    self->capacity += bytes;
    store(words + HISTORY_CAPACITY, self->capacity);
    fence_stores();
}

static bool is_open(const struct history_object *self)
{
    return (PyObject *)self != Py_None && !self->is_disowned && self->words.words != NULL;
}

void history_prepare(struct history_object *self)
{
    if (is_open(self) && self->capacity < self->most_capacity &&
        load(self->words.words + HISTORY_HEAD) + GROWTH_BYTES > self->capacity)
        grow(self, GROWTH_BYTES);
}

/* Drop the oldest records until this many bytes are free behind the head. */
static void make_room(struct history_object *self, uint64_t head, uint64_t bytes)
{
    shared_word *tail_word = self->words.words + HISTORY_TAIL;
    uint64_t tail = load(tail_word);
    while (head + bytes - tail > self->capacity) {
        const uint64_t whole = load(word_at(self, tail)) >> 32;
        if (whole == 0 || whole > head - tail) {
            tail = head; /* somebody has overwritten it: begin again */
            break;
        }
        tail += whole;
    }
    store(tail_word, tail);
    fence_stores(); /* a process may be killed at any time: what is overwritten is no longer told of */
}

/* Whether the data of a record are kept. */
static bool is_kept(struct history_object *self, uint64_t kind, uint64_t whole)
{
    if (kind == EVENT_PUBLISHED)
        return whole <= self->most_capacity / LARGEST_PUBLISHED_SHARE;
    if (whole <= self->most_capacity / LARGEST_SHARE || kind != EVENT_MESSAGE)
        return whole <= self->most_capacity / LARGEST_SHARE;
    const bool has_key = self->has_key && self->key_at >= load(self->words.words + HISTORY_TAIL);
    if (has_key || whole > self->most_capacity / LARGEST_KEY_SHARE)
        return false;
    self->has_key = true;
    self->key_at = load(self->words.words + HISTORY_HEAD);
    return true;
}

void history_append(struct history_object *self, const struct history_event *event, const void *data, uint64_t size)
{
    if (!is_open(self))
        return;
    uint64_t whole = HEAD_BYTES + ((size + 7) & ~(uint64_t)7);
    if (size > self->most_capacity || !is_kept(self, event->kind, whole))
        whole = HEAD_BYTES;
    shared_word *words = self->words.words;
    uint64_t head = load(words + HISTORY_HEAD);
    if (self->capacity < self->most_capacity && head + whole > self->capacity)
        grow(self, whole);
    if (whole > self->capacity)
        whole = HEAD_BYTES; /* there was no room to grow */
    const uint64_t left = self->capacity - head % self->capacity;
    const uint64_t padding = left < whole ? left : 0;
    make_room(self, head, whole + padding);
    if (padding != 0) {
        store(word_at(self, head), EVENT_PADDING | padding << 32);
        head += padding;
    }
    shared_word *record = word_at(self, head);
    const uint64_t number = load(words + HISTORY_RECORDS) + 1;
    const uint64_t row[HISTORY_RECORD_WORDS] = {event->kind | whole << 32, number, size, event->time_ns,
                                                event->values[0], event->values[1], event->values[2],
                                                event->values[3]};
    for (int index = 0; index < HISTORY_RECORD_WORDS; index++)
        store(record + index, row[index]);
    if (whole > HEAD_BYTES)
        memcpy(record + HISTORY_RECORD_WORDS, data, size);
    fence_stores();
    store(words + HISTORY_RECORDS, number);
    store(words + HISTORY_HEAD, head + whole);
}
