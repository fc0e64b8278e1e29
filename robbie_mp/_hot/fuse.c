#ifdef ROBBIE_FUSE
#include "fuse.h"
#include <stdlib.h>

struct fuse fuse = {0, UINT64_MAX, NULL, NULL, 0, 0};

void before_store(shared_word *place, uint64_t value)
{
    if (fuse.stores >= fuse.burns_at && fuse.exit != NULL)
        longjmp(*fuse.exit, 1);
    fuse.stores++;
    if (fuse.traced < fuse.capacity)
        fuse.trace[fuse.traced] = (struct traced_store){place, value};
    fuse.traced++;
}
#endif
