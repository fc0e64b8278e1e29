"""Orders to the supervisor: a page gives them and looks again later, for they take their time."""

import threading
from pathlib import Path

from robbie_mp.errors import RobbieError
from robbie_mp.supervisor.control_client import control


class Order:
    """Stops, starts or restarts a module.

    Args:
        folder: of the run.
        action: "stop", "start" or "restart".
        module: whom it concerns.

    Attributes:
        answer: what the supervisor has said; None as long as it has not.
        is_refused: whether it could not be done.
    """

    def __init__(self, folder: Path, action: str, module: str):
        self._order = (folder, action, module)
        self.answer: str | None = None
        self.is_refused = False
        # Nobody waits for it at the end: a station that has itself stopped would wait for its own death.
        threading.Thread(target=self._give, name=f"{action} {module}", daemon=True).start()

    def _give(self) -> None:
        try:
            self.answer = control(*self._order)
        except RobbieError as error:
            self.is_refused = True
            self.answer = str(error)
