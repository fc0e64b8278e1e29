"""State that outlives its process: `Module.checkpoint(state)` and `Module.restored`.

Its files, in the order in which they build on one another:

    image     the bytes of a checkpoint: its format, and the way from a state to these bytes and back
    buffers   the two shared-memory segments that a module's checkpoints alternate between
    file      one image on disk, replaced atomically, and the thread that writes it
    keeper    all of it, for one incarnation of a module
"""
