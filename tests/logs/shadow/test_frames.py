"""What `robbie shadow` and the shadow send one another."""

import socket

from robbie_mp.logs.shadow.frames import OfShadow, Ready, packed, received


def test_connection_whose_other_end_has_not_read_all_ends_like_any_other() -> None:
    """The shadow ended with a traceback when the command left while it was publishing."""
    ours, theirs = socket.socketpair()
    with ours, theirs:
        theirs.sendall(packed(Ready()))
        ours.sendall(packed(Ready()))
        frames = received(ours, OfShadow)
        assert next(frames) == Ready()
        theirs.close()
        assert list(frames) == []
