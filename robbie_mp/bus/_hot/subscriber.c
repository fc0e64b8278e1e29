/* What robbie_mp/module/inbox.py leaves to C. */
#include "subscriber.h"
#include "endpoint_bindings.h"
#include "history.h"
#include "message_codec.h"
#include "clock.h"
#include "figures.h"

/* Where a Subscription of subscriptions.py has these. */
enum { AT_DECODER = 2, AT_HANDLER = 3, SUBSCRIPTION_FIELDS = 6 };

/* A message to be handled, and what is needed for that. */
struct handled_message {
    struct delivery delivery;
    PyObject *subscription;
    struct mapped_segment_object *segment;
    struct message_bytes_object *bytes;
    uint64_t begun_ns;
    uint64_t newest_before_ns, ill_formed_before; /* what is in the words of the module without this message */
    bool is_lost;
};

/* -- the steps ---------------------------------------------------------------------------------------------- */
/* They return 1, 0 without a store if this is not mine, or -1 with an exception set. */

static int release_unreferenced(struct subscriber_object *self)
{
    while (self->unreferenced->count != 0) {
        if (!endpoint_is_mine(self->endpoint) || ring_room(self->endpoint->endpoint.outbound) == 0)
            return 0;
        PyObject *delivery = remove_pin(self->pins, pop_reference(self->unreferenced));
        if (delivery == NULL)
            return -1;
        const uint64_t reference = PyLong_AsUnsignedLongLong(PyTuple_GET_ITEM(delivery, 2));
        const uint64_t sequence = PyLong_AsUnsignedLongLong(PyTuple_GET_ITEM(delivery, 3));
        Py_DECREF(delivery);
        if (PyErr_Occurred() ||
            endpoint_give_back(self->endpoint, OUTBOUND_RELEASE, reference, sequence) <= 0) /* there was room */
            return -1;
    }
    return 1;
}

/* Look up a number in a dict; 1, 0 or -1. The result is borrowed. */
static int look_up(PyObject *dict, uint64_t number, PyObject **found)
{
    PyObject *key = PyLong_FromUnsignedLongLong(number);
    if (key == NULL)
        return -1;
    *found = PyDict_GetItemWithError(dict, key);
    Py_DECREF(key);
    if (*found != NULL)
        return 1;
    return PyErr_Occurred() ? -1 : 0;
}

/* Find what is needed to handle the delivery; what it refers to is borrowed. */
static int prepare(struct subscriber_object *self, struct handled_message *message)
{
    const struct delivery *delivery = &message->delivery;
    int found = look_up(self->subscriptions, delivery->declaration, &message->subscription);
    if (found <= 0)
        return found;
    if (!PyTuple_Check(message->subscription) || PyTuple_GET_SIZE(message->subscription) != SUBSCRIPTION_FIELDS)
        return 0;
    found = look_up(self->segments, delivery->source, (PyObject **)&message->segment);
    if (found <= 0)
        return found;
    if (!Py_IS_TYPE((PyObject *)message->segment, &mapped_segment_type))
        return 0;
    const uint64_t bytes = (uint64_t)message->segment->words.buffer.len;
    if (delivery->offset > bytes || delivery->size > bytes - delivery->offset)
        return 0;
    const uint64_t free_bytes = load(message->segment->words.words + DATA_FREE_BYTES);
    return pins_have_room(self->pins, delivery, free_bytes);
}

/* Where observers and deadlines find when the newest message of a subscription was published. */
static shared_word *newest_of(shared_word *words, uint64_t declaration)
{
    return words + OUT_DECLARATIONS + declaration % DECLARATION_COUNT * DECLARATION_WORDS + DECLARATION_NEWEST_NS;
}

/* Take the record, and tell what the module does. */
static int begin(struct subscriber_object *self, struct handled_message *message)
{
    shared_word *words = self->words.words;
    MAY_DIE(return -1);
    ring_take(self->endpoint->endpoint.inbound);
    message->begun_ns = monotonic_ns();
    store(words + OUT_ACTIVITY_SINCE_NS, message->begun_ns);
    store(words + OUT_ACTIVITY, ACTIVITY_HANDLER | message->delivery.declaration << 8);
    shared_word *newest = newest_of(words, message->delivery.declaration);
    message->newest_before_ns = load(newest);
    message->ill_formed_before = load(words + OUT_ILL_FORMED);
    store(newest, message->delivery.stamp_ns);
    self->handled = message->delivery;
    self->is_handling = true;
    const struct delivery *delivery = &message->delivery;
    const uint64_t place = delivery->channel | delivery->declaration << 32;
    const struct history_event event = {EVENT_MESSAGE, message->begun_ns,
                                        {place, delivery->sequence, delivery->source, delivery->stamp_ns}};
    history_append(self->history, &event, message->bytes->first, message->bytes->size);
    return 1;
}

static PyObject *decode(struct handled_message *message)
{
    PyObject *decoder = PyTuple_GET_ITEM(message->subscription, AT_DECODER);
    struct message_codec *codec = PyType_Check(decoder) ? codec_of((PyTypeObject *)decoder) : NULL;
    if (codec != NULL && codec->is_installed[FUNCTION_DECODE]) {
        PyObject *decoded = codec_decode(codec, message->bytes->first, (Py_ssize_t)message->bytes->size,
                                         (PyObject *)message->bytes, false);
        if (decoded != NULL || PyErr_Occurred())
            return decoded;
    }
    if (PyErr_Occurred())
        return NULL;
    PyObject *view = PyMemoryView_FromObject((PyObject *)message->bytes);
    PyObject *decoded = view == NULL ? NULL : PyObject_CallMethod(decoder, "decode", "(O)", view);
    Py_XDECREF(view);
    return decoded;
}

/* Count a message that could not be decoded. The error itself would keep frames, and views in them. */
static int tell_lost(PyObject *inbox)
{
    PyObject *type, *error, *trace;
    PyErr_Fetch(&type, &error, &trace);
    PyErr_NormalizeException(&type, &error, &trace);
    PyObject *result = PyObject_CallMethod(inbox, "tell_lost", "(O)", error);
    Py_XDECREF(type);
    Py_XDECREF(error);
    Py_XDECREF(trace);
    Py_XDECREF(result);
    return result == NULL ? -1 : 1;
}

int subscriber_check(const struct subscriber_object *self)
{
    if (self->endpoint->is_disowned) {
        raise_forked_process(); /* a handler forked, and both processes return from it */
        return -1;
    }
    if (self->words.words == NULL) {
        PyErr_SetString(PyExc_ValueError, "this inbox was closed while it handled a message");
        return -1;
    }
    return 1;
}

static int run_handler(struct subscriber_object *self, PyObject *inbox, struct handled_message *message)
{
    PyObject *decoded = decode(message);
    if (decoded == NULL) {
        if (!PyErr_ExceptionMatches(self->robbie_error) || tell_lost(inbox) < 0)
            return -1;
        message->is_lost = true;
    } else {
        PyObject *result = PyObject_CallOneArg(PyTuple_GET_ITEM(message->subscription, AT_HANDLER), decoded);
        Py_DECREF(decoded);
        if (result == NULL)
            return -1;
        Py_DECREF(result);
    }
    return subscriber_check(self);
}

static int count_handled(struct subscriber_object *self, const struct handled_message *message)
{
    shared_word *words = self->words.words, *handled = words + OUT_HANDLED;
    self->is_handling = false;
    MAY_DIE(return -1);
    if (message->is_lost || load(words + OUT_ILL_FORMED) != message->ill_formed_before)
        store(newest_of(words, message->delivery.declaration), message->newest_before_ns); /* no handler got it */
    store(handled, load(handled) + 1);
    return 1;
}

/* Push DONE or RELEASE; if this is not mine, have Python do it. */
static int give_back(struct subscriber_object *self, PyObject *inbox, const struct delivery *delivery, uint64_t kind)
{
    const int given = endpoint_give_back(self->endpoint, kind, delivery->reference, delivery->sequence);
    if (given != 0)
        return given;
    PyObject *tuple = new_delivery(self->endpoint->delivery_type, delivery);
    if (tuple == NULL)
        return -1;
    PyObject *result = PyObject_CallMethod(inbox, kind == OUTBOUND_DONE ? "done" : "release", "(O)", tuple);
    Py_DECREF(tuple);
    Py_XDECREF(result);
    return result == NULL ? -1 : 1;
}

/* Release the message, or pin it if anything refers to its bytes besides `message`. */
static int release_or_pin(struct subscriber_object *self, PyObject *inbox, struct handled_message *message)
{
    if (Py_REFCNT(message->bytes) == 1)
        return give_back(self, inbox, &message->delivery, OUTBOUND_RELEASE);
    /* `message` refers to the bytes until this is done, so nothing can be told before the pin is there. */
    if (keep_message_bytes(message->bytes, self->unreferenced, message->delivery.reference) != 0 ||
        add_pin(self->pins, &message->delivery, self->endpoint->delivery_type) != 0)
        return -1;
    return give_back(self, inbox, &message->delivery, OUTBOUND_DONE);
}

static int finish(struct subscriber_object *self, const struct handled_message *message)
{
    const uint64_t begun_ns = message->begun_ns, stamp_ns = message->delivery.stamp_ns;
    if (subscriber_check(self) < 0)
        return -1;
    MAY_DIE(return -1);
    store(self->words.words + OUT_ACTIVITY, ACTIVITY_IDLE);
    figures_record(self->words.words + OUT_MESSAGE_FIGURES, stamp_ns < begun_ns ? begun_ns - stamp_ns : 0,
                   monotonic_ns() - begun_ns);
    return 1;
}

enum handled subscriber_handle_next(struct subscriber_object *self, PyObject *inbox)
{
    struct handled_message message;
    message.is_lost = false;
    if (self->words.words == NULL || !endpoint_is_mine(self->endpoint))
        return HANDLED_NOT_MINE;
    int done = release_unreferenced(self);
    if (done > 0) {
        switch (endpoint_look(&self->endpoint->endpoint, &message.delivery)) {
        case FOUND_NOTHING:
            return HANDLED_NONE;
        case FOUND_DELIVERY:
            done = prepare(self, &message);
            break;
        default:
            done = 0;
        }
    }
    if (done <= 0)
        return done < 0 ? HANDLED_WITH_ERROR : HANDLED_NOT_MINE;
    message.bytes = new_message_bytes(message.segment, message.delivery.offset, message.delivery.size);
    if (message.bytes == NULL)
        return HANDLED_WITH_ERROR;
    Py_INCREF(message.subscription);
    done = subscriber_check(self) < 0 ? -1 : begin(self, &message);
    if (done > 0)
        done = run_handler(self, inbox, &message);
    if (done > 0)
        done = count_handled(self, &message);
    if (done > 0)
        done = release_or_pin(self, inbox, &message);
    Py_DECREF(message.subscription);
    Py_DECREF(message.bytes);
    if (done > 0)
        done = finish(self, &message);
    return done > 0 ? HANDLED_ONE : HANDLED_WITH_ERROR;
}

void subscriber_record(const struct subscriber_object *self, uint64_t event, uint64_t time_ns)
{
    const struct history_event recorded = {event, time_ns, {0}};
    history_append(self->history, &recorded, NULL, 0);
}

void subscriber_prepare_history(const struct subscriber_object *self)
{
    history_prepare(self->history);
}
