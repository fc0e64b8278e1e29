/* For tests: a process may die before any of its stores. In the normal build there is nothing of this.
 *
 * A binding that reaches `store` says MAY_DIE before its first store. A death then leads back there: the
 * exception of the tests is set, and the statement `leave` is carried out. This ends with the scope of
 * MAY_DIE. Until the last store of the scope the binding must hold nothing that `leave` does not give back,
 * and `leave` may only use variables that were set before MAY_DIE. A store made by Python code that the
 * binding calls leads back to that code's own binding, and comes from there as an exception. */
#ifndef ROBBIE_FUSE_H
#define ROBBIE_FUSE_H

#ifdef ROBBIE_FUSE
#include <Python.h>
#include <setjmp.h>

struct way_out {
    jmp_buf jump;
    struct way_out *outer;
};

void open_way_out(struct way_out *way_out);
void close_way_out(struct way_out *way_out);
void raise_died(void);
int add_fuse_types(PyObject *module);

#define MAY_DIE(leave)                                                                                       \
    struct way_out way_out_here __attribute__((cleanup(close_way_out)));                                     \
    open_way_out(&way_out_here);                                                                             \
    if (setjmp(way_out_here.jump) != 0) {                                                                    \
        raise_died();                                                                                        \
        leave;                                                                                               \
    }
#else
#define MAY_DIE(leave) ((void)0)
#define add_fuse_types(module) 0
#endif

/* Define a function that carries out a statement with stores, for a binding in Cython: 0, or -1 with an exception
 * set. It holds nothing that a death would not give back. */
#define GUARDED(name, parameters, statement)                                                                 \
    static int name parameters                                                                               \
    {                                                                                                        \
        MAY_DIE(return -1);                                                                                  \
        statement;                                                                                           \
        return PyErr_Occurred() == NULL ? 0 : -1;                                                            \
    }
#endif
