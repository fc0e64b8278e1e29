/* Drives the router and its rings with any bytes: for libFuzzer, or on its own with random ones.
 *
 *     fuzz_router COUNT SEED      random inputs
 *     fuzz_router FILE            one input again
 *
 * Modules publish, release and are done as they should, or write anything into their segments; the core
 * handles what it finds. What C leaves to Python is skipped here: a record of another kind is taken, as if
 * Python had done nothing. After every step the books must agree with the tables. */
#include "router.h"
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

enum {
    SLOTS = 4,
    CHANNELS = 3,
    SUBSCRIPTIONS = 7,
    HANDLES = 6,
    REFERENCES = 14,
    RECORDS = 8,
    CREDIT = 3,
    INBOUND = 8,
    FREED = 16,
    MESSAGE_BYTES = 1000,
    SLOTS_AT = CORE_TABLES,
    CHANNELS_AT = SLOTS_AT + SLOTS * PUBLISHER_WORDS,
    SUBSCRIPTIONS_AT = CHANNELS_AT + CHANNELS * CHANNEL_WORDS,
    HANDLES_AT = SUBSCRIPTIONS_AT + SUBSCRIPTIONS * SUBSCRIPTION_WORDS,
    REFERENCES_AT = HANDLES_AT + HANDLES * HANDLE_WORDS,
    CORE_WORDS = REFERENCES_AT + REFERENCES * REFERENCE_WORDS,
    /* The words of a module's segments, in short. */
    HEAD = 0,
    INBOUND_TAIL = 1,
    OUT_RECORDS = 2,
    OUT_WORDS = OUT_RECORDS + RECORDS * RECORD_WORDS,
    OUTBOUND_TAIL = 0,
    INBOUND_HEAD = 1,
    FREED_HEAD = 2,
    IN_RECORDS = 3,
    FREED_NUMBERS = IN_RECORDS + INBOUND * RECORD_WORDS,
    IN_WORDS = FREED_NUMBERS + FREED,
};

/* Each in memory of its own, so that a sanitizer sees who writes past its end. */
struct module {
    shared_word *out, *into;
    struct ring_writer outbound, inbound, freed;
    struct ring_reader served, given;
    struct link link;
    struct slot slot;
    struct reference_list pushed, pinned, waiting;
    uint64_t in_flight[SLOTS], windows[SLOTS];
    uint64_t held[RECORDS][2]; /* references that the module has, with their sequences */
    unsigned held_count;
};

struct run {
    shared_word *core;
    struct books books;
    struct router router;
    struct free_rows free_handles, free_references;
    struct module modules[SLOTS];
    struct channel channels[CHANNELS];
    struct subscription subscriptions[SUBSCRIPTIONS];
    struct subscription *of_channel[CHANNELS][SUBSCRIPTIONS];
    struct link *links[SLOTS];
    unsigned long long wakes;
};

static const uint8_t *input, *input_end;

static unsigned next_byte(void)
{
    return input < input_end ? *input++ : 0;
}

static uint64_t next_word(void)
{
    static const uint64_t odd[] = {UINT64_MAX, UINT64_MAX - 1, UINT64_C(1) << 63, UINT64_C(1) << 32,
                                   UINT64_C(1) << 31, 256, 65535, 65536};
    unsigned kind = next_byte();
    if (kind < 160)
        return kind & 15;
    if (kind < 224)
        return odd[kind % (sizeof odd / sizeof *odd)];
    uint64_t word = 0;
    for (int byte = 0; byte < 8; byte++)
        word = word << 8 | next_byte();
    return word;
}

static void demand(bool holds, const char *what)
{
    if (holds)
        return;
    fprintf(stderr, "violated: %s\n", what);
    abort();
}

static void wake(void *context, struct link *link)
{
    demand(link != NULL && link->slot < SLOTS, "somebody unknown is woken");
    ((struct run *)context)->wakes++;
}

static void *zeros(size_t count, size_t size)
{
    void *memory = calloc(count, size);
    demand(memory != NULL, "there is memory");
    return memory;
}

/* -- a run ----------------------------------------------------------------------------------------------- */

static void make_module(struct run *run, uint64_t index)
{
    struct module *module = &run->modules[index];
    struct books *books = &run->books;
    module->out = zeros(OUT_WORDS, sizeof *module->out);
    module->into = zeros(IN_WORDS, sizeof *module->into);
    struct ring_place out = {module->out + HEAD, module->out + OUT_RECORDS, module->into + OUTBOUND_TAIL, RECORDS};
    struct ring_place into = {module->into + INBOUND_HEAD, module->into + IN_RECORDS,
                              module->out + INBOUND_TAIL, INBOUND};
    struct ring_place freed = {module->into + FREED_HEAD, module->into + FREED_NUMBERS,
                               module->out + INBOUND_TAIL, FREED};
    module->outbound = ring_writer_at(out);
    module->served = ring_reader_at(out);
    module->inbound = ring_writer_at(into);
    module->given = ring_reader_at(into);
    module->freed = ring_writer_at(freed);
    list_init(&module->pushed, books->places, REFERENCES);
    list_init(&module->pinned, books->places, REFERENCES);
    list_init(&module->waiting, books->places, REFERENCES);
    uint64_t window = next_byte() % 2 ? 100 : UINT64_MAX / 2;
    for (int publisher = 0; publisher < SLOTS; publisher++)
        module->windows[publisher] = window;
    module->link = (struct link){
        .slot = index,
        .source = index | UINT64_C(1) << 32,
        .credit = CREDIT,
        .ready = next_byte() % 8 != 0,
        .outbound = &module->served,
        .inbound = &module->inbound,
        .freed = &module->freed,
        .pushed = &module->pushed,
        .pinned = &module->pinned,
        .in_flight = module->in_flight,
        .windows = module->windows,
    };
    module->slot = (struct slot){
        .index = index,
        .at = SLOTS_AT + index * PUBLISHER_WORDS,
        .queue_messages = 1 + next_byte() % 4,
        .queue_bytes = next_byte() % 2 ? 150 : 1 << 30,
        .waiting = &module->waiting,
        .link = next_byte() % 8 ? &module->link : NULL,
    };
    books->slots[index] = &module->slot;
    if (module->slot.link != NULL)
        books->links[books->link_count++] = &module->link;
}

static void make_subscriptions(struct run *run)
{
    for (uint64_t index = 0; index < CHANNELS; index++)
        run->channels[index] = (struct channel){
            .index = index, .at = CHANNELS_AT + index * CHANNEL_WORDS, .subscriptions = run->of_channel[index]};
    for (uint64_t index = 0; index < SUBSCRIPTIONS; index++) {
        unsigned drawn = next_byte();
        run->subscriptions[index] = (struct subscription){
            .index = index,
            .at = SUBSCRIPTIONS_AT + index * SUBSCRIPTION_WORDS,
            .slot = drawn % SLOTS,
            .declaration = index,
            .newest_only = drawn & 128,
            .queued = NO_REFERENCE,
        };
        run->books.subscriptions[index] = &run->subscriptions[index];
        for (uint64_t channel = 0; channel < CHANNELS; channel++)
            if (drawn >> (2 + channel) & 1)
                run->of_channel[channel][run->channels[channel].subscription_count++] = &run->subscriptions[index];
    }
    for (uint64_t slot = 0; slot < SLOTS; slot++)
        for (uint64_t channel = 0; channel < CHANNELS; channel++)
            if (next_byte() % 4)
                run->modules[slot].link.channels[channel] = &run->channels[channel];
}

static struct free_rows *free_all(struct free_rows *rows, uint32_t count)
{
    *rows = (struct free_rows){zeros(count, sizeof *rows->rows), count, count};
    for (uint32_t row = 0; row < count; row++)
        rows->rows[row] = count - 1 - row;
    return rows;
}

static struct run *make_run(void)
{
    struct run *run = zeros(1, sizeof *run);
    run->core = zeros(CORE_WORDS, sizeof *run->core);
    run->books = (struct books){
        .words = run->core,
        .handle_rows = run->core + HANDLES_AT,
        .reference_rows = run->core + REFERENCES_AT,
        .slot_count = SLOTS,
        .subscription_count = SUBSCRIPTIONS,
        .handle_count = HANDLES,
        .reference_count = REFERENCES,
        .free_handles = free_all(&run->free_handles, HANDLES),
        .free_references = free_all(&run->free_references, REFERENCES),
        .holders = zeros(HANDLES, sizeof(uint64_t)),
        .places = zeros(REFERENCES, sizeof(struct place_in_list)),
        .slots = zeros(SLOTS, sizeof(struct slot *)),
        .links = run->links,
        .subscriptions = zeros(SUBSCRIPTIONS, sizeof(struct subscription *)),
    };
    run->router = (struct router){
        .books = &run->books,
        .message_bytes = MESSAGE_BYTES,
        .claims = zeros(SUBSCRIPTIONS, sizeof(uint32_t)),
        .wake = wake,
        .context = run,
        .round = {
            .links = zeros(SLOTS, sizeof(struct link *)),
            .releasing = zeros(SLOTS, sizeof(struct link *)),
            .unfinished = zeros(SLOTS, sizeof(struct link *)),
        },
    };
    for (uint64_t slot = 0; slot < SLOTS; slot++)
        make_module(run, slot);
    make_subscriptions(run);
    return run;
}

static void free_run(struct run *run)
{
    for (int slot = 0; slot < SLOTS; slot++) {
        free(run->modules[slot].out);
        free(run->modules[slot].into);
    }
    free(run->free_handles.rows);
    free(run->free_references.rows);
    free(run->books.holders);
    free(run->books.places);
    free(run->books.slots);
    free(run->books.subscriptions);
    free(run->router.claims);
    free(run->router.round.links);
    free(run->router.round.releasing);
    free(run->router.round.unfinished);
    free(run->core);
    free(run);
}

/* -- what modules do ------------------------------------------------------------------------------------- */

static void send(struct module *module, const uint64_t record[7])
{
    ring_push(&module->outbound, record); /* without looking for room: it may be hostile */
}

static void publish(struct module *module)
{
    uint64_t size = next_byte() * 4;
    send(module, (uint64_t[7]){OUTBOUND_PUBLISH, next_byte() % (CHANNELS + 1),
                               module->link.source | (uint64_t)(next_byte() & 3) << 16, 64, size, next_word(), 7});
}

static void take(struct module *module)
{
    uint64_t record[RECORD_WORDS];
    uint64_t waiting = ring_waiting(&module->given);
    if (waiting == 0 || waiting > INBOUND || module->held_count == RECORDS || !ring_peek(&module->given, record))
        return;
    ring_take(&module->given);
    module->held[module->held_count][0] = record[1];
    module->held[module->held_count++][1] = record[2];
}

static void give(struct module *module, bool is_done)
{
    if (module->held_count == 0)
        return;
    unsigned nth = next_byte() % module->held_count;
    uint64_t *held = module->held[nth];
    send(module, (uint64_t[7]){is_done ? OUTBOUND_DONE : OUTBOUND_RELEASE, held[0], held[1]});
    if (!is_done)
        memmove(held, module->held[--module->held_count], sizeof module->held[0]);
}

static void send_anything(struct module *module)
{
    uint64_t record[7];
    for (int word = 0; word < 7; word++)
        record[word] = next_word();
    if (next_byte() % 2)
        record[0] = OUTBOUND_PUBLISH + record[0] % 3;
    send(module, record);
}

static void scribble(struct module *module)
{
    uint64_t at = next_byte() % OUT_WORDS;
    store(module->out + at, next_word());
}

/* -- what the core does ---------------------------------------------------------------------------------- */

/* Whether a module says of a reference what it may not say: of another message than it was sent. */
static bool is_wrong_answer(const struct run *run, const struct module *module)
{
    uint64_t record[RECORD_WORDS];
    if (!ring_peek(&module->served, record) || (record[0] != OUTBOUND_RELEASE && record[0] != OUTBOUND_DONE))
        return false;
    return record[1] >= REFERENCES ||
           load(run->books.reference_rows + record[1] * REFERENCE_WORDS + REFERENCE_SEQUENCE) != record[2];
}

static void serve_module(struct run *run, struct module *module)
{
    uint64_t waiting = ring_waiting(&module->served);
    if (module->slot.link == NULL || module->link.has_ended || waiting == 0)
        return;
    if (waiting > RECORDS) {
        module->link.has_ended = true; /* RingCorrupt */
        return;
    }
    while (waiting != 0) {
        bool is_wrong = is_wrong_answer(run, module);
        uint64_t record[RECORD_WORDS], handled = serve(&run->router, &module->link, waiting);
        demand(handled <= (is_wrong ? 0 : waiting), "what is not there, or may not be said, is handled");
        waiting -= handled;
        if (waiting == 0)
            return;
        if (!ring_peek(&module->served, record)) {
            module->link.has_ended = true;
            return;
        }
        ring_take(&module->served); /* Python would have done it */
        waiting--;
    }
}

/* Let all modules be served, as often as there are records. */
static void serve_all(struct run *run)
{
    struct link *link;
    uint64_t record[RECORD_WORDS], per_turn = 1 + next_byte() % RECORDS;
    begin_round(&run->router);
    while ((link = serve_round(&run->router, per_turn)) != NULL) {
        demand(!link->has_ended, "a module that has ended gets a turn");
        if (run->router.round.left == UINT64_MAX || !ring_peek(link->outbound, record))
            link->has_ended = true; /* RingCorrupt */
        else
            ring_take(link->outbound); /* Python would have done it */
    }
    demand(run->books.to_post_first == NULL, "somebody is not woken");
    demand(run->books.outdated_first == NULL, "figures are not written");
}

static void change(struct run *run, struct module *module)
{
    switch (next_byte() % 4) {
    case 0:
        module->link.ready = !module->link.ready;
        break;
    case 1:
        run->router.is_special = !run->router.is_special;
        break;
    case 2:
        module->link.awaited_freed = run->router.is_special ? next_byte() : 0;
        break;
    default:
        write_figures(&run->books);
    }
}

/* -- what must hold -------------------------------------------------------------------------------------- */

static uint64_t check_list(const struct run *run, const struct reference_list *list, uint64_t slot)
{
    uint64_t seen = 0;
    uint32_t before = NO_REFERENCE;
    for (uint32_t at = list->first; at != NO_REFERENCE; before = at, at = list->places[at].after) {
        demand(at < REFERENCES && ++seen <= REFERENCES, "a list is a ring, or names what there is not");
        demand(list->places[at].list == list && list->places[at].before == before, "a list is torn");
        const shared_word *row = run->books.reference_rows + at * REFERENCE_WORDS;
        demand(load(row + REFERENCE_STATE) != OUTCOME_FREE, "a free reference is in a list");
        uint64_t subscription = load(row + REFERENCE_SUBSCRIPTION);
        demand(run->subscriptions[subscription].slot == slot, "a reference is in another module's list");
    }
    demand(list->last == before && list->count == seen, "a list does not know its end");
    return seen;
}

static void check_rows(const struct run *run)
{
    const struct books *books = &run->books;
    uint64_t live = 0, held[HANDLES] = {0};
    for (uint64_t row = 0; row < REFERENCES; row++) {
        const shared_word *at = books->reference_rows + row * REFERENCE_WORDS;
        if (load(at + REFERENCE_STATE) == OUTCOME_FREE)
            continue;
        live++;
        uint64_t handle = load(at + REFERENCE_HANDLE);
        demand(load(books->handle_rows + handle * HANDLE_WORDS + HANDLE_SEQUENCE) ==
                   load(at + REFERENCE_SEQUENCE), "a reference is to another message");
        held[handle]++;
    }
    demand(live + books->free_references->count == REFERENCES, "a reference's row was lost");
    live = 0;
    for (uint64_t row = 0; row < HANDLES; row++) {
        bool is_live = load(books->handle_rows + row * HANDLE_WORDS + HANDLE_SEQUENCE) != 0;
        demand(held[row] == books->holders[row] && is_live == (held[row] != 0), "holders are counted wrong");
        live += is_live;
    }
    demand(live + books->free_handles->count == HANDLES, "a message's row was lost");
}

static void check(const struct run *run)
{
    uint64_t ended[SUBSCRIPTIONS] = {0}, of_slots = 0;
    check_rows(run);
    for (uint64_t slot = 0; slot < SLOTS; slot++) {
        const struct module *module = &run->modules[slot];
        of_slots += check_list(run, &module->pushed, slot) + check_list(run, &module->waiting, slot);
        check_list(run, &module->pinned, slot);
        uint64_t bytes = 0, in_flight[SLOTS] = {0};
        for (uint32_t at = module->waiting.first; at != NO_REFERENCE; at = module->waiting.places[at].after)
            bytes += module->waiting.places[at].value;
        demand(bytes == module->slot.waiting_bytes, "waiting bytes are counted wrong");
        demand(module->waiting.count <= module->slot.queue_messages || module->waiting.count == 1, "a queue is too long");
        for (uint32_t at = module->pushed.first; at != NO_REFERENCE; at = module->pushed.places[at].after) {
            uint64_t handle = load(run->books.reference_rows + at * REFERENCE_WORDS + REFERENCE_HANDLE);
            const shared_word *row = run->books.handle_rows + handle * HANDLE_WORDS;
            in_flight[load(row + HANDLE_SOURCE) & SOURCE_SLOT] += load(row + HANDLE_BYTES);
        }
        demand(memcmp(in_flight, module->in_flight, sizeof in_flight) == 0, "bytes in flight are counted wrong");
        demand(module->pushed.count <= CREDIT, "more is in flight than there is credit");
    }
    uint64_t routed = 0;
    for (uint64_t index = 0; index < SUBSCRIPTIONS; index++) {
        const shared_word *row = run->core + run->subscriptions[index].at;
        for (int outcome = SUBSCRIPTION_ROUTED + 1; outcome < SUBSCRIPTION_LAST_SEQUENCE; outcome++)
            ended[index] += load(row + outcome);
        routed += load(row + SUBSCRIPTION_ROUTED) - ended[index];
    }
    demand(routed == of_slots, "a message is not counted");
}

/* -------------------------------------------------------------------------------------------------------- */

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
    input = data;
    input_end = data + size;
    struct run *run = make_run();
    while (input < input_end) {
        unsigned step = next_byte();
        struct module *module = &run->modules[step % SLOTS];
        switch (step / SLOTS % 16) {
        case 0: case 1: case 2: case 3:
            publish(module);
            break;
        case 4: case 5: case 6:
            take(module);
            break;
        case 7: case 8:
            give(module, false);
            break;
        case 9:
            give(module, true);
            break;
        case 10:
            send_anything(module);
            break;
        case 11:
            scribble(module);
            break;
        case 12:
            change(run, module);
            break;
        case 13:
            serve_all(run);
            break;
        default:
            serve_module(run, module);
        }
        check(run);
    }
    free_run(run);
    return 0;
}

#ifndef WITH_LIBFUZZER
static uint64_t random_state;

static uint64_t draw(void) /* xorshift64*, Vigna 2016 */
{
    random_state ^= random_state >> 12;
    random_state ^= random_state << 25;
    random_state ^= random_state >> 27;
    return random_state * UINT64_C(2685821657736338717);
}

int main(int argc, char **argv)
{
    static uint8_t data[1 << 16];
    if (argc == 2) {
        FILE *file = fopen(argv[1], "rb");
        demand(file != NULL, "the input can be read");
        size_t size = fread(data, 1, sizeof data, file);
        fclose(file);
        return LLVMFuzzerTestOneInput(data, size);
    }
    demand(argc == 3, "usage: fuzz_router COUNT SEED");
    unsigned long long count = strtoull(argv[1], NULL, 10);
    random_state = strtoull(argv[2], NULL, 10) * 2 + 1;
    for (unsigned long long nth = 0; nth < count; nth++) {
        size_t size = 64 + draw() % 960;
        for (size_t at = 0; at < size; at++)
            data[at] = (uint8_t)(draw() >> 32);
        LLVMFuzzerTestOneInput(data, size);
    }
    printf("%llu inputs, nothing to report\n", count);
    return 0;
}
#endif
