/* A module releases a message while the core falls asleep: the core must learn of the release.
 *
 * The module pushes the release and then looks whether the core wants to be woken. The core says so and then
 * looks at the ring once more. This plays every order in which the two do that and in which their stores become
 * visible. If neither sees what the other has stored, a message waits until the core's next heartbeat: then this
 * ends with code 66. */
#include "endpoint.h"
#include "router.h"
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <ucontext.h>

enum { CAPACITY = 4, SLOT = 1, MISSED = 66, STACK_BYTES = 64 << 10, MAX_STORES = 8, MAX_STEPS = 64 };
enum { MODULE, CORE, THREADS };

static shared_word out_head, out_records[CAPACITY * RECORD_WORDS], out_tail;
static shared_word in_words[IN_RING];

/* -- threads whose stores are seen late ------------------------------------------------------------------ */

struct thread {
    ucontext_t context;
    char stack[STACK_BYTES];
    bool has_ended, is_at_fence;
    struct {
        shared_word *place;
        uint64_t value;
    } stores[MAX_STORES]; /* that only this thread sees yet, the oldest first */
    unsigned store_count;
};

static struct thread threads[THREADS];
static struct thread *running; /* NULL: nothing is raced for */
static ucontext_t scheduler;

/* Only these words decide who learns what; all others are stored at once. */
static bool is_raced_for(const shared_word *place)
{
    return running != NULL && (place == &out_head || place == in_words + IN_WANT_RELEASE);
}

static void let_others_run(void)
{
    swapcontext(&running->context, &scheduler);
}

void store(shared_word *place, uint64_t value)
{
    if (!is_raced_for(place)) {
        place->word = value;
        return;
    }
    let_others_run();
    if (running->store_count == MAX_STORES)
        abort();
    running->stores[running->store_count].place = place;
    running->stores[running->store_count++].value = value;
}

uint64_t load(const shared_word *place)
{
    if (!is_raced_for(place))
        return place->word;
    let_others_run();
    for (unsigned left = running->store_count; left != 0; left--)
        if (running->stores[left - 1].place == place)
            return running->stores[left - 1].value;
    return place->word;
}

void fence(void)
{
    if (running == NULL)
        return;
    running->is_at_fence = true;
    let_others_run();
    running->is_at_fence = false;
}

static void show_oldest_store(struct thread *thread)
{
    thread->stores[0].place->word = thread->stores[0].value;
    memmove(thread->stores, thread->stores + 1, --thread->store_count * sizeof *thread->stores);
}

/* -- every order ----------------------------------------------------------------------------------------- */

static unsigned choices[MAX_STEPS], options[MAX_STEPS], steps;

/* Choose one of several ways to go on: as before up to some step, and then the first way. */
static unsigned choose(unsigned count)
{
    if (steps == MAX_STEPS)
        abort();
    options[steps] = count;
    return choices[steps++];
}

/* Prepare the next order; false if all have been played. */
static bool next_order(void)
{
    while (steps != 0) {
        if (++choices[--steps] < options[steps])
            return true;
        choices[steps] = 0;
    }
    return false;
}

/* Run the threads to their ends, and show all their stores, in the order of the choices. */
static void run_threads(void)
{
    for (;;) {
        struct thread *ways[2 * THREADS];
        unsigned count = 0, runs;
        for (unsigned number = 0; number < THREADS; number++) {
            struct thread *thread = &threads[number];
            if (!thread->has_ended && !(thread->is_at_fence && thread->store_count != 0))
                ways[count++] = thread;
        }
        runs = count;
        for (unsigned number = 0; number < THREADS; number++)
            if (threads[number].store_count != 0)
                ways[count++] = &threads[number];
        if (count == 0)
            return;
        unsigned way = choose(count);
        if (way < runs) {
            running = ways[way];
            swapcontext(&scheduler, &running->context);
            running = NULL;
        } else {
            show_oldest_store(ways[way]);
        }
    }
}

/* -- the module and the core ------------------------------------------------------------------------------ */

static struct endpoint endpoint;
static struct books books;
static struct ring_reader outbound;
static bool has_posted, has_seen;

static void release_message(void)
{
    if (!endpoint_return(&endpoint, OUTBOUND_RELEASE, 0, 1))
        abort();
    has_posted = endpoint_is_wanted(&endpoint);
    threads[MODULE].has_ended = true;
}

static void fall_asleep(void)
{
    has_seen = before_sleep(&books) && ring_waiting(&outbound) != 0;
    threads[CORE].has_ended = true;
}

static void begin(struct thread *thread, void (*run)(void))
{
    thread->has_ended = thread->is_at_fence = false;
    thread->store_count = 0;
    getcontext(&thread->context);
    thread->context.uc_stack.ss_sp = thread->stack;
    thread->context.uc_stack.ss_size = sizeof thread->stack;
    thread->context.uc_link = &scheduler;
    makecontext(&thread->context, run, 0);
}

/* A module has one message, and another one waits for it. Return whether the core learns of the release. */
static bool play(void)
{
    out_head.word = out_tail.word = in_words[IN_WANT_RELEASE].word = 0;
    struct ring_place place = {&out_head, out_records, &out_tail, CAPACITY};
    struct ring_writer writer = ring_writer_at(place), inbound = {.place = {.head = in_words + IN_HEAD}};
    struct ring_reader taken = {.tail = 1};
    outbound = ring_reader_at(place);
    endpoint = (struct endpoint){
        .outbound = &writer, .inbound = &taken, .want_release = in_words + IN_WANT_RELEASE};
    struct place_in_list places[2] = {{0}};
    struct reference_list pushed, pinned, waiting;
    list_init(&pushed, places, 2);
    list_init(&pinned, places, 2);
    list_init(&waiting, places, 2);
    list_append(&pushed, 0, 0);
    list_append(&waiting, 1, 64);
    struct link link = {
        .slot = SLOT, .outbound = &outbound, .inbound = &inbound, .pushed = &pushed, .pinned = &pinned};
    struct slot slot = {.index = SLOT, .waiting = &waiting, .link = &link};
    struct slot *slots[] = {&slot, &slot};
    struct link *links[] = {&link};
    books = (struct books){
        .slot_count = 2, .places = places, .slots = slots, .links = links, .link_count = 1, .reference_count = 2};
    begin(&threads[MODULE], release_message);
    begin(&threads[CORE], fall_asleep);
    run_threads();
    return has_posted || has_seen;
}

int main(void)
{
    unsigned orders = 0, posted = 0, seen = 0;
    do {
        steps = 0;
        orders++;
        if (!play()) {
            printf("missed in order %u\n", orders);
            return MISSED;
        }
        posted += has_posted;
        seen += has_seen;
    } while (next_order());
    printf("%u orders, %u posted, %u seen\n", orders, posted, seen);
    return 0;
}
