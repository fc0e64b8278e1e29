/* Fences as ThreadSanitizer understands them. This file is compiled without ThreadSanitizer's instrumentation. */
#include "tsan_words.h"

void *__tsan_create_fiber(unsigned flags);
void __tsan_destroy_fiber(void *fiber);
void __tsan_switch_to_fiber(void *fiber, unsigned flags);
void *__tsan_get_current_fiber(void);
void __tsan_acquire(void *place);
void __tsan_release(void *place);
void __tsan_atomic64_store(volatile uint64_t *place, uint64_t value, int order);
uint64_t __tsan_atomic64_load(const volatile uint64_t *place, int order);

enum { WITHOUT_ORDER = 1 }; /* switching between fibers orders nothing by itself */

static _Thread_local struct {
    void *thread;
    void *storer; /* has seen what the thread did before its last release fence; stores for it */
    void *loader; /* has seen what others did before the words that the thread has loaded; loads for it */
    char released, acquired;
} own;

void begin_fences(void)
{
    own.thread = __tsan_get_current_fiber();
    own.storer = __tsan_create_fiber(0);
    own.loader = __tsan_create_fiber(0);
}

void end_fences(void)
{
    __tsan_destroy_fiber(own.storer);
    __tsan_destroy_fiber(own.loader);
}

void store(shared_word *place, uint64_t value)
{
    __tsan_switch_to_fiber(own.storer, WITHOUT_ORDER);
    __tsan_atomic64_store(&place->word, value, __ATOMIC_RELEASE);
    __tsan_switch_to_fiber(own.thread, WITHOUT_ORDER);
}

uint64_t load(const shared_word *place)
{
    __tsan_switch_to_fiber(own.loader, WITHOUT_ORDER);
    uint64_t value = __tsan_atomic64_load(&place->word, __ATOMIC_ACQUIRE);
    __tsan_switch_to_fiber(own.thread, WITHOUT_ORDER);
    return value;
}

void fence_stores(void)
{
    __tsan_release(&own.released);
    __tsan_switch_to_fiber(own.storer, WITHOUT_ORDER);
    __tsan_acquire(&own.released);
    __tsan_switch_to_fiber(own.thread, WITHOUT_ORDER);
}

void fence_loads(void)
{
    __tsan_switch_to_fiber(own.loader, WITHOUT_ORDER);
    __tsan_release(&own.acquired);
    __tsan_switch_to_fiber(own.thread, WITHOUT_ORDER);
    __tsan_acquire(&own.acquired);
}

void fence(void)
{
    fence_loads();
    fence_stores();
}
