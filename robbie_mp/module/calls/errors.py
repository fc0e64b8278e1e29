"""How a call ends without a reply, and how calls and services are misused."""

from robbie_mp.base.errors import RobbieError


class CallError(RobbieError):
    """A call ended without a reply; the text says which call, and why."""


class NoServer(CallError, LookupError):
    """No module serves the request.

    Example scenarios:
      - the profile has no such module, or it serves the request on another topic
      - the server was stopped, or failed and has no restarts left
    """


class ServerDied(CallError, ConnectionError):
    """The server died while it handled the request, or shortly after; what it did is unknown.

    Requests that it had not begun to handle are not lost: its next incarnation gets them.
    """


class CallLost(CallError, ConnectionError):
    """The server lives but does not know the call: the request or the reply was dropped.

    Example scenarios:
      - the server's queue was full, so that the request was dropped
      - the server had no memory for the reply
      - the reply was ill-formed
    """


class CallTimedOut(CallError, TimeoutError):
    """There was no reply in time. The server may still handle the request; its reply will be ignored."""


class CallRefused(CallError, RuntimeError):
    """The server refused the request; the text is the server's.

    A server's handler raises it:

        raise CallRefused("the goal is inside a wall")
    """


class CallNotSent(CallError, MemoryError):
    """The request was refused because this module's memory or ring is full."""


class GoalCancelled(CallError, RuntimeError):
    """The goal's client cancelled it, and the server has ended the work."""


class GoalAborted(CallError, RuntimeError):
    """The server accepted the goal, but cannot reach it; the text is the server's."""


class GoalPreempted(CallError, RuntimeError):
    """Another goal has taken the goal's place; the text is the server's."""


class GoalEnded(RobbieError, RuntimeError):
    """A server ended a goal, or told of its progress, after the goal had ended."""


class TooManyCalls(RobbieError, BufferError):
    """A module has too many calls that have not ended; call less often, or with a shorter timeout."""


class InvalidTimeout(RobbieError, ValueError):
    """The timeout of a call is not a positive, finite number of seconds."""


class CalledInSetup(RobbieError, RuntimeError):
    """A module called in `setup()`, when its server may not serve yet; call from the first tick on."""


class WrongThread(RobbieError, RuntimeError):
    """A module called or served in another thread than its main one."""


class WrongReply(RobbieError, TypeError):
    """The handler of a service returned something else than the reply that belongs to the request."""


class ServedTwice(RobbieError, ValueError):
    """Two modules serve the same requests; the one that the profile starts first keeps them.

    Example scenarios:
      - a profile has two modules of the same class, and both serve on the same topic
    """


class CannotServe(RobbieError, RuntimeError):
    """A module that runs as a tool serves: it is not supervised, so its clients could not rely on it."""
