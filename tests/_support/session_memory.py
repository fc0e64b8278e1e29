"""Makes the session's folder for shared memory. Import it before robbie_mp, which looks at the variable."""

from tests._support import own_memory

SESSION_MEMORY = own_memory.make()
