"""The root of every error that Robbie-MP raises.

Each package declares its own errors next to the code that raises them; each is a `RobbieError` and also the
built-in it resembles, so that `except ValueError` works for who does not know us.
"""


class RobbieError(Exception):
    """Something that Robbie-MP refuses or cannot do; the text says what, where, and what to do.

    Example scenarios:
      - a profile names a module class that does not exist
      - a message is larger than a segment can hold
    """
