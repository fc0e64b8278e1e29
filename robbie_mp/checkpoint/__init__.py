"""State that outlives its process: `Module.checkpoint(state)` and `Module.restored`.

Its files, in the order in which they build on one another:

    image         the bytes of a checkpoint: their form and their header
    encoder       from a state to an image, each array copied once
    decoder       from an image, whatever it holds, to a state or a CheckpointDamaged
    buffers       the two shared-memory segments a module's checkpoints alternate between
    file          one image on disk, replaced atomically
    disk_writer   the thread that brings checkpoints to disk
    keeper        all of it, for one incarnation of a module
"""
