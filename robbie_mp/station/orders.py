"""Orders to the supervisor: a page gives them and looks again later, for they take their time."""

import threading
from functools import partial
from pathlib import Path

from robbie_mp.errors import RobbieError
from robbie_mp.run.control import control


class Order:
    """Stops, starts or restarts a module, or says what is recorded of it.

    Args:
        folder: of the run.
        action: "stop", "start", "restart" or "record".
        module: whom it concerns; None: all modules.
        more: what else belongs to the order.

    Attributes:
        answer: what the supervisor has said; None as long as it has not.
        is_refused: whether it could not be done.
    """

    def __init__(self, folder: Path, action: str, module: str | None, **more: object):
        self._give = partial(control, folder, action, module, **more)
        self.answer: str | None = None
        self.is_refused = False
        # Nobody waits for it at the end: a station that has itself stopped would wait for its own death.
        threading.Thread(target=self._be_given, name=f"{action} {module}", daemon=True).start()

    def _be_given(self) -> None:
        try:
            self.answer = self._give()
        except RobbieError as error:
            self.is_refused = True
            self.answer = str(error)
