/* Arrays of numpy, through the C interface that numpy offers to every extension at run time. Its headers are
 * not needed to build this: what is used here has been the same since numpy 1.7. */
#ifndef ROBBIE_NUMPY_ARRAYS_H
#define ROBBIE_NUMPY_ARRAYS_H

#include "native.h"

/* The part of numpy's PyArrayObject_fields that is used here. */
struct numpy_array {
    PyObject_HEAD
    char *data;
    int dimension_count;
    Py_ssize_t *dimensions;
    Py_ssize_t *strides; /* in bytes */
    PyObject *base;
    PyObject *dtype;
    int flags;
};

/* Find numpy's interface; 0, 1: this numpy is of an unknown version, or -1 with an exception set. */
int find_numpy(void);

/* The array that `object` is: exactly numpy's type, this dtype and one dimension; otherwise NULL. */
struct numpy_array *array_of(PyObject *object, PyObject *dtype);

/* Whether the elements of a one-dimensional array lie one behind the other. */
static inline bool has_no_gaps(const struct numpy_array *array, size_t element_size)
{
    return array->dimensions[0] <= 1 || array->strides[0] == (Py_ssize_t)element_size;
}

/* An array that shows memory; it keeps `pin` alive. NULL with an exception set if there is no memory for it. */
PyObject *array_view(PyObject *dtype, size_t element_size, Py_ssize_t count, const uint8_t *data,
                     bool is_writable, PyObject *pin);

#endif
