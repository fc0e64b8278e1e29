"""The module that gets what a node of ROS 2 has published."""

from pathlib import Path

from robbie_mp import REQUIRED, Module, setting
from robbie_mp.messages import Image, String
from tools.bench.peers.rclpy import parts
from tools.bench.record import Receipts
from tools.bench.work import Work


class RosSubscriber(Module):
    """Records messages until the last one."""

    work_file: Path = setting(REQUIRED, "the work, as JSON")

    def setup(self) -> None:
        """Subscribe."""
        work = Work.load(self.work_file)
        self.receipts = Receipts(work, 0)
        if work.has_array:
            self.subscribe(Image, self.record, topic="bench")
        else:
            self.subscribe(String, self.record, topic="bench")

    def record(self, message: Image | String) -> None:
        """Record one."""
        if self.receipts.handle(*parts(message)):
            self.stop()
