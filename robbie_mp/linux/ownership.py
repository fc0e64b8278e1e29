"""Whether something in the file system is ours alone, so that nobody else can have put anything into it."""

import os
import stat


def ownership_problem(found: os.stat_result, *, folder: bool = False, readable: bool = False) -> str:
    """Return why a file or folder is not safe to use, '' if it is.

    Args:
        found: what fstat(2) says of it; lstat(2) where it cannot be replaced by somebody else.
        folder: whether a folder is expected; else it is a regular file.
        readable: whether others may read it, as long as they cannot write to it.
    """
    if not (stat.S_ISDIR if folder else stat.S_ISREG)(found.st_mode):
        return "is no directory" if folder else "is no regular file"
    if found.st_uid != os.geteuid():
        return f"belongs to user {found.st_uid}, not to us ({os.geteuid()})"
    if readable and found.st_mode & 0o022:
        return f"has mode {stat.S_IMODE(found.st_mode):04o}, others must not be able to write to it"
    if not readable and found.st_mode & 0o077:
        private = "0700" if folder else "0600"
        return f"has mode {stat.S_IMODE(found.st_mode):04o}, others must have no access ({private})"
    return ""
