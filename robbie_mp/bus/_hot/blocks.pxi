# The Python types Block and KeptBlocks, with the interface of those in robbie_mp/bus/transport/blocks.py.

cdef extern from "layout.h":
    enum: DATA_BLOCKS, LEAD_BYTES

cdef extern from "blocks.h":
    PyObject *kept_for(KeptBlocks blocks, uint64_t size) except? NULL
    int take_block(KeptBlocks blocks, PyObject *list) except -1
    int keep_block(KeptBlocks blocks, Block block) except -1
    int free_block(KeptBlocks blocks, uint64_t number) except -1

cdef extern from *:
    """
    GUARDED(try_to_tell_free_bytes, (struct kept_blocks_object *blocks, struct block_object *block),
            tell_free_bytes(blocks, block))
    """
    int try_to_tell_free_bytes(KeptBlocks blocks, Block block) except -1


@cython.no_gc
cdef public class Block [object block_object, type block_type]:
    """A part of a data segment that holds one message."""

    cdef public unsigned long long number
    cdef readonly unsigned long long segment, offset, capacity
    cdef readonly object buffer  # the whole segment, as Python uses it
    cdef held_words words  # the same memory, held

    def __cinit__(
        self,
        unsigned long long number,
        unsigned long long segment,
        unsigned long long offset,
        buffer,
        unsigned long long capacity,
        words,
    ):
        hold_words(&self.words, words, True)
        self.number, self.segment, self.offset, self.capacity = number, segment, offset, capacity
        self.buffer = buffer
        cdef uint64_t size = self.words.buffer.len
        if (
            self.words.count < DATA_BLOCKS
            or not LEAD_BYTES <= offset <= size
            or not LEAD_BYTES <= capacity <= size - (offset - LEAD_BYTES)
        ):
            raise ValueError("the block does not fit into its memory")

    def __dealloc__(self):
        release_words(&self.words)


@cython.no_gc_clear
cdef public class KeptBlocks [object kept_blocks_object, type kept_blocks_type]:
    """The blocks in use and the free ones."""

    cdef readonly dict taken  # blocks in use, by their numbers
    cdef readonly dict kept  # lists of free blocks, by their capacity
    cdef unsigned long long numbers
    cdef readonly unsigned long long taken_bytes
    cdef public unsigned long long room_bytes

    def __cinit__(self):
        self.taken, self.kept = {}, {}

    cdef PyObject *list_for(self, uint64_t size) except? NULL:
        if size > <uint64_t>INT64_MAX:
            raise OverflowError("no message is so large")
        return kept_for(self, size)

    def reuse(self, uint64_t size, /):
        """Return a kept block for a message of this size, or None."""
        kept = self.list_for(size)
        if kept == NULL:
            return None
        block = <Block>(<list>kept)[-1]
        take_block(self, kept)
        try_to_tell_free_bytes(self, block)
        return block

    def has_kept(self, uint64_t size, /):
        """Whether `reuse` would find a block."""
        return self.list_for(size) != NULL

    def keep(self, Block block not None, /):
        """Keep a new block."""
        keep_block(self, block)

    def free(self, numbers, /):
        """Free blocks; numbers that are not in use are ignored."""
        for number in numbers:
            free_block(self, number)

    def clear(self):
        """Let all blocks go."""
        self.taken.clear()
        self.kept.clear()
        self.taken_bytes = 0
