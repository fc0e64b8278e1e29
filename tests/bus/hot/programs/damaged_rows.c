/* A module releases a message whose row in the core's own table is damaged.
 *
 *     damaged_rows handle|subscription INDEX
 *
 * It uses the run of fuzz_router.c. */
#define main fuzz_router
#include "fuzz_router.c"
#undef main

static void connect(struct run *run, struct module *module)
{
    module->link.ready = true;
    module->slot.link = &module->link;
    module->slot.queue_messages = RECORDS;
    module->link.channels[0] = &run->channels[0];
    run->books.links[run->books.link_count++] = &module->link;
}

int main(int argc, char **argv)
{
    demand(argc == 3, "usage: damaged_rows handle|subscription INDEX");
    struct run *run = make_run();
    struct module *publisher = &run->modules[0], *subscriber = &run->modules[1];
    connect(run, publisher);
    connect(run, subscriber);
    run->subscriptions[0].slot = 1;
    run->of_channel[0][run->channels[0].subscription_count++] = &run->subscriptions[0];
    run->books.subscriptions[1] = NULL; /* a row that no subscription has been opened in */

    send(publisher, (uint64_t[7]){OUTBOUND_PUBLISH, 0, publisher->link.source, 64, 8, 1, 7});
    demand(serve(&run->router, &publisher->link, 1) == 1, "a message is routed");
    take(subscriber);
    demand(subscriber->held_count == 1, "it was delivered");
    uint64_t column = strcmp(argv[1], "handle") == 0 ? REFERENCE_HANDLE : REFERENCE_SUBSCRIPTION;
    uint64_t reference = subscriber->held[0][0];
    store(run->books.reference_rows + reference * REFERENCE_WORDS + column, strtoull(argv[2], NULL, 0));
    give(subscriber, false);
    printf("%llu handled\n", (unsigned long long)serve(&run->router, &subscriber->link, 1));
    write_figures(&run->books);
    free_run(run);
    return 0;
}
