"""Commands to the supervisor. They take time, so a page gives one and reads the answer later."""

import threading
from functools import partial
from pathlib import Path

from robbie_mp.base.errors import RobbieError
from robbie_mp.run.control import control


class ModuleOrder:
    """Stops, starts or restarts a module, or sets what the trace records of it.

    Args:
        folder: folder of the run.
        action: "stop", "start", "restart" or "record".
        module: the module; None: all modules.
        more: further arguments of the command.

    Attributes:
        answer: the supervisor's answer; None until it arrives.
        is_refused: whether the supervisor refused the command.
    """

    def __init__(self, folder: Path, action: str, module: str | None, **more: object):
        self._give = partial(control, folder, action, module, **more)
        self.answer: str | None = None
        self.is_refused = False
        # A daemon: a station that stops itself must not wait for the answer at its end.
        threading.Thread(target=self._be_given, name=f"{action} {module}", daemon=True).start()

    def _be_given(self) -> None:
        try:
            self.answer = self._give()
        except RobbieError as error:
            self.is_refused = True
            self.answer = str(error)
