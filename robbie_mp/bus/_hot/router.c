/* The router's hot path: messages are entered, sent, counted, and their blocks given back.
 *
 * A module may have written anything into its records. So each is checked before the first store: what Python
 * would refuse, and what it would have to do besides, is not done here. */
#include "router.h"
#include <stdlib.h>

static const uint64_t MAX_OFFSET = UINT64_MAX >> 1;

/* A message, as its row in the table of handles has it. */
struct message {
    uint64_t sequence, source, offset, size, channel, stamp_ns, block;
};

static shared_word *handle_row(const struct books *books, uint64_t index)
{
    return books->handle_rows + index * HANDLE_WORDS;
}

static shared_word *reference_row(const struct books *books, uint64_t index)
{
    return books->reference_rows + index * REFERENCE_WORDS;
}

/* Only the core writes the indexes in its rows. If one is wrong, its memory is damaged: it ends here, before it
 * writes where the index leads, and its successor looks at all rows. */
static uint64_t index_within(uint64_t index, uint64_t count)
{
    if (index >= count)
        abort();
    return index;
}

static uint32_t message_of(const struct books *books, uint32_t reference)
{
    uint64_t index = load(reference_row(books, reference) + REFERENCE_HANDLE);
    return (uint32_t)index_within(index, books->handle_count);
}

static struct subscription *subscription_of(const struct books *books, uint32_t reference)
{
    uint64_t index = load(reference_row(books, reference) + REFERENCE_SUBSCRIPTION);
    struct subscription *found = books->subscriptions[index_within(index, books->subscription_count)];
    if (found == NULL)
        abort();
    return found;
}

static struct message read_message(const struct books *books, uint32_t index)
{
    const shared_word *row = handle_row(books, index);
    return (struct message){
        .sequence = load(row + HANDLE_SEQUENCE),
        .source = load(row + HANDLE_SOURCE),
        .offset = load(row + HANDLE_OFFSET),
        .size = load(row + HANDLE_BYTES),
        .channel = load(row + HANDLE_CHANNEL),
        .stamp_ns = load(row + HANDLE_STAMP_NS),
        .block = load(row + HANDLE_BLOCK),
    };
}

/* The publisher of a message; NULL if it is dead. */
static struct link *publisher_of(const struct books *books, uint64_t source)
{
    struct link *link = books->slots[source & SOURCE_SLOT]->link;
    return link != NULL && link->source == (source & SOURCE_OF_INCARNATION) ? link : NULL;
}

/* -- ledger.py ------------------------------------------------------------------------------------------ */

static uint32_t open_handle(struct books *books, const struct message *message, uint64_t record,
                            uint64_t publisher_routed, uint64_t channel_messages, uint64_t channel_bytes)
{
    uint32_t index = books->free_handles->rows[--books->free_handles->count];
    shared_word *row = handle_row(books, index);
    store(row + HANDLE_RECORD, NO_RECORD); /* a takeover must not take a half-written row for this record's */
    store(row + HANDLE_SOURCE, message->source);
    store(row + HANDLE_OFFSET, message->offset);
    store(row + HANDLE_BYTES, message->size);
    store(row + HANDLE_CHANNEL, message->channel);
    store(row + HANDLE_STAMP_NS, message->stamp_ns);
    store(row + HANDLE_BLOCK, message->block);
    store(row + HANDLE_PUBLISHER_ROUTED, publisher_routed);
    store(row + HANDLE_CHANNEL_MESSAGES, channel_messages);
    store(row + HANDLE_CHANNEL_BYTES, channel_bytes);
    store(row + HANDLE_RECORD, record);
    store(row + HANDLE_SEQUENCE, message->sequence); /* commits: from here on the message is routed */
    return index;
}

static uint32_t open_reference(struct books *books, const struct subscription *subscription, uint32_t handle,
                               uint64_t sequence)
{
    uint32_t index = books->free_references->rows[--books->free_references->count];
    shared_word *row = reference_row(books, index), *counts = books->words + subscription->at;
    uint64_t routed = load(counts + SUBSCRIPTION_ROUTED) + 1;
    store(row + REFERENCE_SEQUENCE, sequence);
    store(row + REFERENCE_HANDLE, handle);
    store(row + REFERENCE_SUBSCRIPTION, subscription->index);
    store(row + REFERENCE_PUSHED_AT, 0);
    store(row + REFERENCE_STATE, OUTCOME_HELD | routed << 8); /* commits */
    store(counts + SUBSCRIPTION_ROUTED, routed);
    store(counts + SUBSCRIPTION_LAST_SEQUENCE, sequence);
    books->holders[handle]++;
    return index;
}

/* Give one block back to its publisher, and wake the publisher if it waits for this one. */
static void free_block(struct router *router, struct link *publisher, uint64_t block)
{
    number_ring_push(publisher->freed, block);
    if (publisher->awaited_freed != 0 && publisher->awaited_freed <= publisher->freed->head) {
        publisher->awaited_freed = 0;
        router->wake(router->context, publisher);
    }
}

/* Give a message's block back to its publisher if that is alive, and then free the message's row. */
static void give_back(struct router *router, uint32_t index)
{
    struct books *books = router->books;
    shared_word *row = handle_row(books, index);
    struct link *publisher = publisher_of(books, load(row + HANDLE_SOURCE));
    if (publisher != NULL)
        free_block(router, publisher, load(row + HANDLE_BLOCK));
    store(row + HANDLE_SEQUENCE, 0);
    books->free_handles->rows[books->free_handles->count++] = index;
}

static void count(struct books *books, uint32_t reference, uint64_t outcome)
{
    shared_word *counted = books->words + subscription_of(books, reference)->at + SUBSCRIPTION_ROUTED + outcome - 1;
    uint64_t nth = load(counted) + 1;
    store(reference_row(books, reference) + REFERENCE_STATE, outcome | nth << 8); /* commits */
    store(counted, nth);
}

static void close_reference(struct router *router, uint32_t reference)
{
    struct books *books = router->books;
    uint32_t handle = message_of(books, reference);
    store(reference_row(books, reference) + REFERENCE_STATE, OUTCOME_FREE);
    books->free_references->rows[books->free_references->count++] = reference;
    if (--books->holders[handle] == 0)
        give_back(router, handle);
}

static void finish(struct router *router, uint32_t reference, uint64_t outcome)
{
    count(router->books, reference, outcome);
    close_reference(router, reference);
}

/* -- queues.py ------------------------------------------------------------------------------------------ */

void note_post(struct books *books, struct link *link)
{
    if (link->is_to_post)
        return;
    link->is_to_post = true;
    link->to_post_next = NULL;
    *(books->to_post_first == NULL ? &books->to_post_first : &books->to_post_last->to_post_next) = link;
    books->to_post_last = link;
}

void post(struct router *router)
{
    struct link *link;
    while ((link = router->books->to_post_first) != NULL) {
        router->books->to_post_first = link->to_post_next;
        link->is_to_post = false;
        router->wake(router->context, link);
    }
}

/* Whether a module that has messages may be sent one more, by their number and their bytes. */
static bool may_follow(const struct subscription *subscription, uint64_t source, uint64_t size,
                       const struct link *link)
{
    if (subscription->newest_only || link->pushed->count >= link->credit)
        return false;
    uint64_t publisher = source & SOURCE_SLOT, in_flight = link->in_flight[publisher];
    return in_flight == 0 || in_flight + size <= link->windows[publisher];
}

static void push(struct books *books, const struct subscription *subscription, uint32_t reference,
                 const struct message *message, struct link *link)
{
    uint64_t record = link->inbound->head;
    list_append(link->pushed, reference, record);
    link->in_flight[message->source & SOURCE_SLOT] += message->size;
    store(reference_row(books, reference) + REFERENCE_PUSHED_AT, record + 1);
    ring_push(link->inbound, (uint64_t[7]){
        INBOUND_DELIVER | subscription->declaration << DECLARATION_SHIFT | message->channel << CHANNEL_SHIFT,
        reference, message->sequence, message->source, message->offset, message->size, message->stamp_ns,
    });
}

/* Take a message out of the queue. */
static void remove_waiting(struct books *books, struct slot *slot, uint32_t reference)
{
    slot->waiting_bytes -= list_remove(slot->waiting, reference);
    struct subscription *subscription = subscription_of(books, reference);
    if (subscription->queued == reference)
        subscription->queued = NO_REFERENCE;
}

/* Push waiting messages in order, up to the module's credit. */
static void pump(struct books *books, struct slot *slot, struct link *link)
{
    bool sent = false;
    while (slot->waiting->count != 0) {
        uint32_t reference = slot->waiting->first;
        const struct subscription *subscription = subscription_of(books, reference);
        struct message message = read_message(books, message_of(books, reference));
        if (link->pushed->count != 0 && !may_follow(subscription, message.source, message.size, link))
            break;
        remove_waiting(books, slot, reference);
        push(books, subscription, reference, &message, link);
        sent = true;
    }
    if (sent)
        note_post(books, link);
}

static void queue(struct router *router, struct slot *slot, struct subscription *subscription, uint32_t reference,
                  uint64_t size)
{
    struct books *books = router->books;
    if (subscription->newest_only) {
        uint32_t old = subscription->queued;
        if (old != NO_REFERENCE) {
            remove_waiting(books, slot, old);
            finish(router, old, OUTCOME_REPLACED);
        }
        subscription->queued = reference;
    }
    list_append(slot->waiting, reference, size);
    slot->waiting_bytes += size;
    if (slot->link != NULL && slot->link->ready)
        pump(books, slot, slot->link);
    while (slot->waiting->count > 1 &&
           (slot->waiting->count > slot->queue_messages || slot->waiting_bytes > slot->queue_bytes)) {
        uint32_t oldest = slot->waiting->first;
        remove_waiting(books, slot, oldest);
        finish(router, oldest, OUTCOME_DROPPED);
    }
}

/* Before a message is queued: drop what waits of its channel, if its publisher paces itself. */
static void yield_to_pace(struct router *router, struct slot *slot, uint32_t reference,
                          const struct message *message, struct channel *channel)
{
    struct books *books = router->books;
    const struct link *publisher = publisher_of(books, message->source);
    if (publisher == NULL || !publisher->paces)
        return;
    uint32_t old = channel->paced_reference;
    if (list_has(slot->waiting, old) &&
        load(reference_row(books, old) + REFERENCE_SEQUENCE) == channel->paced_sequence &&
        publisher_of(books, load(handle_row(books, message_of(books, old)) + HANDLE_SOURCE)) != NULL) {
        remove_waiting(books, slot, old);
        finish(router, old, OUTCOME_DROPPED);
    }
    channel->paced_reference = reference;
    channel->paced_sequence = message->sequence;
}

/* Send a message, or queue it behind others; if the queue is full, drop its oldest message. */
static void add(struct router *router, struct subscription *subscription, uint32_t reference,
                const struct message *message, struct channel *channel)
{
    struct books *books = router->books;
    struct slot *slot = books->slots[subscription->slot];
    struct link *link = slot->link;
    if (link != NULL && link->ready && slot->waiting->count == 0 &&
        (link->pushed->count == 0 || may_follow(subscription, message->source, message->size, link))) {
        push(books, subscription, reference, message, link);
        if (router->holds_posts)
            note_post(books, link);
        else
            router->wake(router->context, link);
    } else {
        if (slot->yields)
            yield_to_pace(router, slot, reference, message, channel);
        queue(router, slot, subscription, reference, message->size);
    }
    outdate(books, slot);
}

/* -- flow.py -------------------------------------------------------------------------------------------- */

static void count_message(struct books *books, const struct channel *channel, const struct message *message)
{
    shared_word *row = books->words + channel->at;
    uint64_t messages = load(row + CHANNEL_MESSAGES), bytes = load(row + CHANNEL_BYTES);
    uint64_t last_ns = load(row + CHANNEL_LAST_STAMP_NS), squares = load(row + CHANNEL_INTERVALS_SQUARED);
    if (last_ns != 0) {
        /* Between stamps in whole µs, so that intervals add up; the sign does not matter to the square. */
        uint64_t stamp_us = message->stamp_ns / 1000, last_us = last_ns / 1000;
        uint64_t interval_us = stamp_us >= last_us ? stamp_us - last_us : last_us - stamp_us;
        if (interval_us > MAX_INTERVAL_US)
            interval_us = MAX_INTERVAL_US;
        squares += interval_us * interval_us;
    }
    store(row + CHANNEL_MESSAGES, messages + 1);
    store(row + CHANNEL_BYTES, bytes + message->size);
    store(row + CHANNEL_LAST_STAMP_NS, message->stamp_ns);
    store(row + CHANNEL_INTERVALS_SQUARED, squares);
}

static void route(struct router *router, struct slot *slot, struct channel *channel, uint32_t index,
                  const struct message *message)
{
    struct books *books = router->books;
    store(books->words + CORE_LAST_SEQUENCE, message->sequence);
    for (uint64_t nth = 0; nth < channel->subscription_count; nth++)
        router->claims[nth] = open_reference(books, channel->subscriptions[nth], index, message->sequence);
    for (uint64_t nth = 0; nth < channel->subscription_count; nth++)
        add(router, channel->subscriptions[nth], router->claims[nth], message, channel);
    shared_word *routed = books->words + slot->at + PUBLISHER_ROUTED;
    store(routed, load(routed) + 1);
    count_message(books, channel, message);
    if (channel->subscription_count == 0)
        give_back(router, index);
}

/* Whether nothing but a block is given back when a message ends: no dead publisher must be announced as gone. */
static bool is_simple(const struct books *books, uint32_t handle)
{
    return publisher_of(books, load(handle_row(books, handle) + HANDLE_SOURCE)) != NULL;
}

/* Whether a message for these subscriptions may end another one of a dead publisher. */
static bool may_end_another(const struct books *books, const struct channel *channel, uint64_t size)
{
    uint64_t count = channel->subscription_count;
    for (uint64_t nth = 0; nth < count; nth++) {
        const struct subscription *subscription = channel->subscriptions[nth];
        const struct slot *slot = books->slots[subscription->slot];
        if (slot->waiting->count == 0)
            continue;
        if (slot->waiting->count + count > slot->queue_messages ||
            slot->waiting_bytes + count * size > slot->queue_bytes)
            return true;
        if (subscription->queued != NO_REFERENCE && !is_simple(books, message_of(books, subscription->queued)))
            return true;
    }
    return false;
}

static bool on_publish(struct router *router, struct slot *slot, struct link *link, const uint64_t record[8])
{
    struct books *books = router->books;
    uint64_t declaration = record[1], source = record[2], offset = record[3], size = record[4];
    struct channel *channel = declaration < DECLARATION_COUNT ? link->channels[declaration] : NULL;
    if (channel == NULL || (source & SOURCE_OF_INCARNATION) != link->source || size > router->message_bytes ||
        offset > MAX_OFFSET)
        return false;
    if (books->free_handles->count == 0 || books->free_references->count < channel->subscription_count)
        return false;
    if (router->is_special && may_end_another(books, channel, size))
        return false;
    const struct message message = {
        .sequence = load(books->words + CORE_LAST_SEQUENCE) + 1,
        .source = source,
        .offset = offset,
        .size = size,
        .channel = channel->index,
        .stamp_ns = record[5],
        .block = record[6],
    };
    const shared_word *figures = books->words + channel->at;
    uint32_t index = open_handle(books, &message, link->outbound->tail,
                                 load(books->words + slot->at + PUBLISHER_ROUTED) + 1,
                                 load(figures + CHANNEL_MESSAGES) + 1, load(figures + CHANNEL_BYTES) + size);
    route(router, slot, channel, index, &message);
    return true;
}

/* Whether a list has a reference to the message of a record. */
static bool is_in(const struct books *books, const struct reference_list *list, const uint64_t record[8])
{
    return list_has(list, record[1]) &&
           load(reference_row(books, record[1]) + REFERENCE_SEQUENCE) == record[2];
}

/* Whether nothing but a block is given back when a reference ends. */
static bool ends_simply(const struct router *router, uint32_t reference)
{
    if (!router->is_special)
        return true;
    const struct books *books = router->books;
    uint32_t handle = message_of(books, reference);
    return books->holders[handle] > 1 || is_simple(books, handle);
}

/* Take a reference out of what a module has been sent. */
static void take_back(struct books *books, struct link *link, uint32_t reference)
{
    const shared_word *row = handle_row(books, message_of(books, reference));
    list_remove(link->pushed, reference);
    link->in_flight[load(row + HANDLE_SOURCE) & SOURCE_SLOT] -= load(row + HANDLE_BYTES);
}

static bool on_done(struct router *router, struct slot *slot, struct link *link, const uint64_t record[8])
{
    struct books *books = router->books;
    if (!is_in(books, link->pushed, record))
        return false;
    uint32_t reference = (uint32_t)record[1];
    take_back(books, link, reference);
    list_append(link->pinned, reference, 0);
    count(books, reference, OUTCOME_DELIVERED);
    pump(books, slot, link);
    outdate(books, slot);
    return true;
}

static bool on_release(struct router *router, struct slot *slot, struct link *link, const uint64_t record[8])
{
    struct books *books = router->books;
    uint32_t reference = (uint32_t)record[1];
    bool is_pushed = is_in(books, link->pushed, record);
    if (!(is_pushed || is_in(books, link->pinned, record)) || !ends_simply(router, reference))
        return false;
    if (is_pushed) {
        take_back(books, link, reference);
        finish(router, reference, OUTCOME_DELIVERED);
    } else {
        list_remove(link->pinned, reference);
        close_reference(router, reference);
    }
    pump(books, slot, link);
    outdate(books, slot);
    return true;
}

static bool on_wait_freed(struct router *router, struct link *link, const uint64_t record[8])
{
    bool waits = record[1] > link->freed->head;
    link->awaited_freed = waits ? record[1] : 0;
    link->paces = true;
    if (!waits)
        router->wake(router->context, link);
    return true;
}

/* -- router.py ------------------------------------------------------------------------------------------ */

static bool handle(struct router *router, struct slot *slot, struct link *link, const uint64_t record[8])
{
    switch (record[0]) {
    case OUTBOUND_PUBLISH:
        return on_publish(router, slot, link, record);
    case OUTBOUND_RELEASE:
        return on_release(router, slot, link, record);
    case OUTBOUND_DONE:
        return on_done(router, slot, link, record);
    case OUTBOUND_WAIT_FREED:
        return on_wait_freed(router, link, record);
    default:
        return false;
    }
}

uint64_t serve(struct router *router, struct link *link, uint64_t records)
{
    struct slot *slot = router->books->slots[link->slot];
    uint64_t record[RECORD_WORDS], handled = 0;
    for (; handled < records; handled++) {
        router->holds_posts = handled + 1 < records;
        if (!ring_peek(link->outbound, record) || !handle(router, slot, link, record))
            break;
        ring_take(link->outbound);
    }
    if (handled == records)
        post(router);
    return handled;
}

static bool is_linked(const struct books *books, const struct link *link)
{
    for (uint64_t index = 0; index < books->link_count; index++)
        if (books->links[index] == link)
            return true;
    return false;
}

static void give_turn(struct round *round, struct link *link)
{
    if (link->is_in_round)
        return;
    link->is_in_round = true;
    round->links[round->count++] = link;
}

void begin_round(struct router *router)
{
    struct books *books = router->books;
    struct round *round = &router->round;
    round->count = round->next = round->releasing_count = round->releasing_next = 0;
    round->current = NULL;
    for (uint64_t index = 0; index < books->link_count; index++) {
        struct link *link = books->links[index];
        uint64_t head = load(link->outbound->place.head);
        if (head != link->head_seen)
            give_turn(round, link);
        link->head_seen = head;
    }
    for (uint64_t index = 0; index < round->unfinished_count; index++)
        if (is_linked(books, round->unfinished[index])) /* or else it is gone since then */
            give_turn(round, round->unfinished[index]);
    round->unfinished_count = 0;
    for (uint64_t index = 0; index < round->count; index++)
        round->links[index]->is_in_round = false;
}

/* Find out whose turn is next; NULL: nobody's. */
static struct link *next_link(struct round *round)
{
    while (round->next < round->count) {
        struct link *link = round->links[round->next++];
        if (link->has_ended)
            continue;
        if (ring_glance(link->outbound) != OUTBOUND_RELEASE)
            return link;
        round->releasing[round->releasing_count++] = link;
    }
    while (round->releasing_next < round->releasing_count) {
        struct link *link = round->releasing[round->releasing_next++];
        if (!link->has_ended)
            return link;
    }
    return NULL;
}

/* Begin a turn; false if the ring is corrupt. */
static bool begin_turn(struct round *round, struct link *link, uint64_t records_per_turn)
{
    uint64_t waiting = ring_waiting(link->outbound);
    round->left = UINT64_MAX;
    if (waiting > link->outbound->place.capacity)
        return false;
    if (waiting > records_per_turn) {
        round->unfinished[round->unfinished_count++] = link;
        waiting = records_per_turn;
    }
    round->current = link;
    round->left = waiting;
    return true;
}

struct link *serve_round(struct router *router, uint64_t records_per_turn)
{
    struct round *round = &router->round;
    for (;;) {
        if (round->current == NULL) {
            struct link *link = next_link(round);
            if (link == NULL)
                break;
            if (!begin_turn(round, link, records_per_turn))
                return link;
        }
        struct link *link = round->current;
        if (!link->has_ended) /* it ends if Python finds its record broken */
            round->left -= serve(router, link, round->left);
        if (link->has_ended || round->left == 0) {
            round->current = NULL;
        } else {
            round->left--;
            return link;
        }
    }
    post(router);
    write_figures(router->books);
    return NULL;
}

static bool somebody_awaits_blocks(const struct books *books)
{
    for (uint64_t index = 0; index < books->link_count; index++)
        if (books->links[index]->awaited_freed != 0)
            return true;
    return false;
}

/* Ask a module to post when it releases a message, or not to; whether it may have missed the request. */
static bool want_release(struct link *link, bool is_wanted)
{
    const struct reference_list *pushed = link->pushed;
    uint64_t end = pushed->count != 0 ? pushed->places[pushed->last].value + 1 : link->inbound->head, want = 0;
    if (is_wanted) {
        want = end - pushed->count / 2;
        if (want == 0)
            want = 1;
    }
    if (want == link->wanted_release)
        return false;
    store(link->inbound->place.head + (IN_WANT_RELEASE - IN_HEAD), want); /* it lies between head and records */
    link->wanted_release = want;
    return is_wanted;
}

bool before_sleep(struct books *books)
{
    bool blocks_awaited = somebody_awaits_blocks(books), look_again = false;
    if (!blocks_awaited && !somebody_waits(books) && !books->is_wanting)
        return false;
    books->is_wanting = false;
    for (uint64_t index = 0; index < books->link_count; index++) {
        struct link *link = books->links[index];
        bool is_waited_for = books->slots[link->slot]->waiting->count != 0 ||
                             (blocks_awaited && (link->pushed->count != 0 || link->pinned->count != 0));
        look_again |= want_release(link, is_waited_for);
        books->is_wanting |= is_waited_for;
    }
    if (look_again)
        fence(); /* the module sees the request, or the core what the module has released */
    return look_again;
}
