/* The Python type Endpoint: what robbie_mp/bus/transport/endpoint.py leaves to C. */
#include "endpoint_bindings.h"
#include <structmember.h>

bool endpoint_is_mine(const struct endpoint_object *self)
{
    return !self->is_disowned && self->outbound->words.words != NULL && self->inbound->words.words != NULL &&
           self->freed->words.words != NULL && self->in_words.words != NULL &&
           PyObject_Size(self->backlog) == 0 && !lock_is_elsewhere(self->lock);
}

int endpoint_wake_core(struct endpoint_object *self)
{
    if (self->core != NULL) {
        wakeup_post(self->core);
        return 0;
    }
    if (lock_take(self->lock) != 0)
        return -1;
    PyObject *result = PyObject_CallNoArgs(self->wake_core);
    lock_give(self->lock);
    Py_XDECREF(result);
    return result == NULL ? -1 : 0;
}

int endpoint_give_back(struct endpoint_object *self, uint64_t kind, uint64_t reference, uint64_t sequence)
{
    MAY_DIE(return -1);
    if (!endpoint_is_mine(self) || !endpoint_return(&self->endpoint, kind, reference, sequence))
        return 0;
    if (endpoint_is_wanted(&self->endpoint) && endpoint_wake_core(self) != 0)
        return -1;
    return 1;
}

PyObject *new_delivery(PyTypeObject *type, const struct delivery *delivery)
{
    const uint64_t words[] = {delivery->declaration, delivery->channel, delivery->reference,
                              delivery->sequence,    delivery->source,  delivery->offset,
                              delivery->size,        delivery->stamp_ns};
    const Py_ssize_t count = sizeof(words) / sizeof(words[0]);
    PyObject *tuple = type->tp_alloc(type, count); /* of a named tuple: its own constructor takes longer */
    for (Py_ssize_t index = 0; tuple != NULL && index < count; index++) {
        PyObject *word = PyLong_FromUnsignedLongLong(words[index]);
        if (word == NULL)
            Py_CLEAR(tuple);
        else
            PyTuple_SET_ITEM(tuple, index, word);
    }
    return tuple;
}

static PyObject *endpoint_new(PyTypeObject *type, PyObject *args, PyObject *keywords)
{
    static char *names[] = {"outbound", "inbound", "freed",     "in_words", "source",
                            "reserve",  "backlog", "lock", "wake_core", "delivery", NULL};
    PyObject *outbound, *inbound, *freed, *in_words, *backlog, *lock, *wake_core;
    PyTypeObject *delivery_type;
    unsigned long long source, reserve;
    if (!PyArg_ParseTupleAndKeywords(args, keywords, "O!O!O!OKKOO!OO!", names, &ring_writer_type, &outbound,
                                     &ring_reader_type, &inbound, &number_ring_reader_type, &freed, &in_words,
                                     &source, &reserve, &backlog, &lock_type, &lock, &wake_core, &PyType_Type,
                                     &delivery_type))
        return NULL;
    if (!PyType_IsSubtype(delivery_type, &PyTuple_Type)) {
        PyErr_SetString(PyExc_TypeError, "a delivery must be a named tuple");
        return NULL;
    }
    struct endpoint_object *self = (struct endpoint_object *)type->tp_alloc(type, 0);
    if (self == NULL)
        return NULL;
    self->outbound = (struct ring_writer_object *)Py_NewRef(outbound);
    self->inbound = (struct ring_reader_object *)Py_NewRef(inbound);
    self->freed = (struct ring_reader_object *)Py_NewRef(freed);
    self->backlog = Py_NewRef(backlog);
    self->lock = (struct lock_object *)Py_NewRef(lock);
    self->wake_core = Py_NewRef(wake_core);
    self->core = wakeup_of(wake_core);
    self->delivery_type = (PyTypeObject *)Py_NewRef(delivery_type);
    if (hold_words(&self->in_words, in_words, false) != 0) {
        Py_DECREF(self);
        return NULL;
    }
    if (self->in_words.count <= IN_WANT_RELEASE) {
        Py_DECREF(self);
        PyErr_SetString(PyExc_ValueError, "these are not the words of an inbound segment");
        return NULL;
    }
    self->endpoint = (struct endpoint){
        .outbound = &self->outbound->ring,
        .inbound = &self->inbound->ring,
        .freed = &self->freed->ring,
        .want_release = self->in_words.words + IN_WANT_RELEASE,
        .source = source,
        .reserve = reserve,
    };
    return (PyObject *)self;
}

static int endpoint_traverse(struct endpoint_object *self, visitproc visit, void *arg)
{
    Py_VISIT(self->backlog);
    Py_VISIT(self->wake_core);
    Py_VISIT(self->delivery_type);
    return 0;
}

/* The fields stay valid for code that reads them during the collection; no C code runs Python code then. */
static int endpoint_clear(struct endpoint_object *self)
{
    self->is_disowned = true; /* nothing is pushed any more */
    self->core = NULL;
    Py_CLEAR(self->wake_core);
    return 0;
}

static void endpoint_dealloc(struct endpoint_object *self)
{
    PyObject_GC_UnTrack(self);
    release_words(&self->in_words);
    Py_XDECREF(self->outbound);
    Py_XDECREF(self->inbound);
    Py_XDECREF(self->freed);
    Py_XDECREF(self->backlog);
    Py_XDECREF(self->lock);
    Py_XDECREF(self->wake_core);
    Py_XDECREF(self->delivery_type);
    Py_TYPE(self)->tp_free(self);
}

static PyObject *publish(struct endpoint_object *self, PyObject *args)
{
    struct placed_message message;
    unsigned long long declaration, segment, offset, size, stamp_ns, block;
    if (!PyArg_ParseTuple(args, "KKKKKK", &declaration, &segment, &offset, &size, &stamp_ns, &block))
        return NULL;
    message = (struct placed_message){segment, offset, size, block};
    MAY_DIE(return NULL);
    if (!endpoint_is_mine(self) || !endpoint_may_publish(&self->endpoint))
        Py_RETURN_FALSE;
    endpoint_publish(&self->endpoint, declaration, &message, stamp_ns);
    if (endpoint_wake_core(self) != 0)
        return NULL;
    Py_RETURN_TRUE;
}

static PyObject *give_back(struct endpoint_object *self, PyObject *args)
{
    unsigned long long kind, reference, sequence;
    if (!PyArg_ParseTuple(args, "KKK", &kind, &reference, &sequence))
        return NULL;
    const int done = endpoint_give_back(self, kind, reference, sequence);
    return done < 0 ? NULL : PyBool_FromLong(done);
}

static PyObject *take(struct endpoint_object *self, PyObject *Py_UNUSED(ignored))
{
    struct delivery delivery;
    if (!endpoint_is_mine(self))
        Py_RETURN_NOTIMPLEMENTED;
    switch (endpoint_look(&self->endpoint, &delivery)) {
    case FOUND_NOTHING:
        Py_RETURN_NONE;
    case FOUND_DELIVERY:
        break;
    default:
        Py_RETURN_NOTIMPLEMENTED;
    }
    PyObject *made = new_delivery(self->delivery_type, &delivery);
    if (made == NULL)
        return NULL;
    MAY_DIE(Py_DECREF(made); return NULL);
    ring_take(self->endpoint.inbound);
    return made;
}

static PyObject *let_go(struct endpoint_object *self, PyObject *Py_UNUSED(ignored))
{
    release_words(&self->in_words);
    self->core = NULL;
    Py_RETURN_NONE;
}

static PyObject *disown(struct endpoint_object *self, PyObject *Py_UNUSED(ignored))
{
    self->is_disowned = true;
    return let_go(self, NULL);
}

static PyMethodDef endpoint_methods[] = {
    {"publish", (PyCFunction)publish, METH_VARARGS, "Publish a filled block; False if this is not mine."},
    {"give_back", (PyCFunction)give_back, METH_VARARGS, "Push RELEASE or DONE; False if this is not mine."},
    {"take", (PyCFunction)take, METH_NOARGS,
     "Take the next delivery; None if there is no record, NotImplemented if this is not mine."},
    {"close", (PyCFunction)let_go, METH_NOARGS, "Let go of the memory."},
    {"disown", (PyCFunction)disown, METH_NOARGS, "Do nothing any more, in a forked process."},
    {0},
};

PyTypeObject endpoint_type = {
    PyVarObject_HEAD_INIT(NULL, 0)
    .tp_name = "robbie_mp.bus._hot.native.Endpoint",
    .tp_doc = "The common form of what robbie_mp.bus.transport.endpoint.Endpoint does.",
    .tp_basicsize = sizeof(struct endpoint_object),
    .tp_flags = Py_TPFLAGS_DEFAULT | Py_TPFLAGS_HAVE_GC,
    .tp_new = endpoint_new,
    .tp_dealloc = (destructor)endpoint_dealloc,
    .tp_traverse = (traverseproc)endpoint_traverse,
    .tp_clear = (inquiry)endpoint_clear,
    .tp_methods = endpoint_methods,
};

int add_endpoint_type(PyObject *module)
{
    return PyModule_AddType(module, &endpoint_type);
}
