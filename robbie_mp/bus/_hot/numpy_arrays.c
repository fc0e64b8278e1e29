/* Arrays of numpy, through its C interface: checked, and made as views of memory. */
#include "numpy_arrays.h"

/* Places in numpy's table, see numpy/core/code_generators/numpy_api.py; numpy never changes them. */
enum { GET_ABI_VERSION = 0, ARRAY_TYPE = 2, NEW_FROM_DTYPE = 94, SET_BASE = 282 };

enum { ABI_1 = 0x01000009, ABI_2 = 0x02000000 };

enum { IS_C_CONTIGUOUS = 0x0001, IS_ALIGNED = 0x0100, IS_WRITEABLE = 0x0400 };

typedef unsigned int abi_version_function(void);
typedef PyObject *new_function(PyTypeObject *type, PyObject *dtype, int dimension_count,
                               const Py_ssize_t *dimensions, const Py_ssize_t *strides, void *data, int flags,
                               PyObject *like);
typedef int set_base_function(PyObject *array, PyObject *base);

/* As numpy's own headers keep it: there is one numpy in a process. */
static struct {
    PyTypeObject *array_type; /* NULL: not found yet */
    new_function *new_from_dtype;
    set_base_function *set_base;
} numpy;

static PyObject *import_core(void)
{
    PyObject *module = PyImport_ImportModule("numpy._core._multiarray_umath"); /* since numpy 2 */
    if (module != NULL || !PyErr_ExceptionMatches(PyExc_ImportError))
        return module;
    PyErr_Clear();
    return PyImport_ImportModule("numpy.core._multiarray_umath");
}

int find_numpy(void)
{
    if (numpy.array_type != NULL)
        return 0;
    PyObject *module = import_core();
    if (module == NULL)
        return -1;
    PyObject *capsule = PyObject_GetAttrString(module, "_ARRAY_API");
    Py_DECREF(module);
    if (capsule == NULL)
        return -1;
    void **table = PyCapsule_GetPointer(capsule, NULL);
    Py_DECREF(capsule); /* the table is numpy's, which is never unloaded */
    if (table == NULL)
        return -1;
    unsigned int version = ((abi_version_function *)table[GET_ABI_VERSION])();
    if (version != ABI_1 && version != ABI_2)
        return 1;
    numpy.new_from_dtype = (new_function *)table[NEW_FROM_DTYPE];
    numpy.set_base = (set_base_function *)table[SET_BASE];
    numpy.array_type = (PyTypeObject *)table[ARRAY_TYPE];
    return 0;
}

struct numpy_array *array_of(PyObject *object, PyObject *dtype)
{
    if (!Py_IS_TYPE(object, numpy.array_type))
        return NULL;
    struct numpy_array *array = (struct numpy_array *)object;
    return array->dtype == dtype && array->dimension_count == 1 ? array : NULL;
}

PyObject *array_view(PyObject *dtype, size_t element_size, Py_ssize_t count, const uint8_t *data,
                     bool is_writable, PyObject *pin)
{
    int flags = IS_C_CONTIGUOUS;
    if ((uintptr_t)data % element_size == 0)
        flags |= IS_ALIGNED;
    if (is_writable)
        flags |= IS_WRITEABLE;
    Py_INCREF(dtype); /* numpy takes this reference, and that to the pin, even if it fails */
    PyObject *array =
        numpy.new_from_dtype(numpy.array_type, dtype, 1, &count, NULL, (void *)(uintptr_t)data, flags, NULL);
    if (array == NULL)
        return NULL;
    Py_INCREF(pin);
    if (numpy.set_base(array, pin) != 0) {
        Py_DECREF(array);
        return NULL;
    }
    return array;
}
