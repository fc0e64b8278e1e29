"""Kills mapping at a certain message, once."""

import os
import signal
from contextlib import closing
from pathlib import Path

from robbie_mp import Module, setting
from robbie_mp.bus.observe import RunObserver
from robbie_mp.messages import Odometry


class Assassin(Module):
    """In lockstep, after mapping in the profile: mapping has handled the message, and holds nothing."""

    at: int = setting(100, "the odometry message at which it strikes")

    def setup(self) -> None:
        self.seen = 0
        self.subscribe(Odometry, self.on_odometry, topic="odom")

    def on_odometry(self, _odometry: Odometry) -> None:
        self.seen += 1
        if self.seen == self.at:
            with closing(RunObserver(self.run_id)) as observer:
                (pid,) = [module.pid for module in observer.modules() if module.name == "mapping"]
            os.kill(pid, signal.SIGKILL)
            Path(self.output_directory, "struck").touch()
