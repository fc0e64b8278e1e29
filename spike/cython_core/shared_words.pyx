cimport cython

@cython.final
cdef class SharedWords:
    def __init__(self, buffer):
        cdef const uint64_t[::1] view = buffer
        self.buffer = memoryview(buffer)
        self.at = <shared_word *> &view[0]
        self.count = len(buffer)

    def __len__(self):
        return self.count

    def __getitem__(self, index):
        return self.load(range(self.count)[index])

    def __setitem__(self, index, value):
        self.store(range(self.count)[index], value)

    def close(self):
        pass
