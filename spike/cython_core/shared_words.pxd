from libc.stdint cimport uint64_t

cdef extern from "words.h":
    ctypedef struct shared_word:
        pass
    uint64_t c_load "load"(const shared_word *place) noexcept nogil
    void c_store "store"(shared_word *place, uint64_t value) noexcept nogil
    void fence() noexcept nogil
    void fence_stores() noexcept nogil
    void fence_loads() noexcept nogil

cdef class SharedWords:
    cdef object buffer
    cdef shared_word *at
    cdef Py_ssize_t count
    cdef inline uint64_t load(self, uint64_t index) noexcept:
        return c_load(self.at + index)
    cdef inline void store(self, uint64_t index, uint64_t value) noexcept:
        c_store(self.at + index, value)
