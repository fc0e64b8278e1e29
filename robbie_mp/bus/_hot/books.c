/* The books of the core: lists of references, and the figures of the modules. */
#include "books.h"

void list_init(struct reference_list *list, struct place_in_list *places, uint64_t references)
{
    *list = (struct reference_list){places, references, 0, NO_REFERENCE, NO_REFERENCE};
}

void list_clear(struct reference_list *list)
{
    while (list->count != 0)
        list_remove(list, list->first);
}

void list_forget(const struct reference_list *list)
{
    for (uint64_t reference = 0; reference < list->references; reference++)
        if (list->places[reference].list == list)
            list->places[reference].list = NULL;
}

bool list_has(const struct reference_list *list, uint64_t reference)
{
    return reference < list->references && list->places[reference].list == list;
}

static void link_in(struct reference_list *list, uint32_t before, uint32_t reference, uint32_t after)
{
    struct place_in_list *places = list->places;
    places[reference].list = list;
    places[reference].before = before;
    places[reference].after = after;
    *(before == NO_REFERENCE ? &list->first : &places[before].after) = reference;
    *(after == NO_REFERENCE ? &list->last : &places[after].before) = reference;
    list->count++;
}

void list_append(struct reference_list *list, uint32_t reference, uint64_t value)
{
    struct reference_list *other = list->places[reference].list;
    if (other != NULL)
        list_remove(other, reference);
    list->places[reference].value = value;
    link_in(list, list->last, reference, NO_REFERENCE);
}

uint64_t list_remove(struct reference_list *list, uint32_t reference)
{
    struct place_in_list *place = &list->places[reference];
    *(place->before == NO_REFERENCE ? &list->first : &list->places[place->before].after) = place->after;
    *(place->after == NO_REFERENCE ? &list->last : &list->places[place->after].before) = place->before;
    place->list = NULL;
    list->count--;
    return place->value;
}

void list_move_to_front(struct reference_list *list, uint32_t reference)
{
    list_remove(list, reference);
    link_in(list, NO_REFERENCE, reference, list->first);
}

void outdate(struct books *books, struct slot *slot)
{
    if (slot->is_outdated)
        return;
    slot->is_outdated = true;
    slot->outdated_next = NULL;
    *(books->outdated_first == NULL ? &books->outdated_first : &books->outdated_last->outdated_next) = slot;
    books->outdated_last = slot;
}

static void write_slot(struct books *books, const struct slot *slot)
{
    shared_word *row = books->words + slot->at;
    uint64_t waiting = slot->waiting->count;
    store(row + PUBLISHER_WAITING, waiting);
    store(row + PUBLISHER_WAITING_BYTES, slot->waiting_bytes);
    store(row + PUBLISHER_IN_FLIGHT, slot->link == NULL ? 0 : slot->link->pushed->count);
    store(row + PUBLISHER_PINNED, slot->link == NULL ? 0 : slot->link->pinned->count);
    if (waiting > load(row + PUBLISHER_WAITING_PEAK))
        store(row + PUBLISHER_WAITING_PEAK, waiting);
}

void write_figures(struct books *books)
{
    struct slot *slot;
    while ((slot = books->outdated_first) != NULL) {
        write_slot(books, slot);
        books->outdated_first = slot->outdated_next;
        slot->is_outdated = false;
    }
}

bool somebody_waits(const struct books *books)
{
    for (uint64_t index = 0; index < books->slot_count; index++)
        if (books->slots[index]->waiting->count != 0 && books->slots[index]->link != NULL)
            return true;
    return false;
}
