"""A node of ROS 2 publishes, and a module behind the bridge gets it: the bridge in the place of a relay."""

import sys
from pathlib import Path

import yaml

from tools.bench.peers.rclpy import DEPTH, Rclpy, domain_of, topic_of
from tools.bench.work import Work

MODULES = "tools.bench.ros2_modules"


class BridgedSubscriber(Rclpy):
    """The subscriber is a module of a robot; bridge and core stand where a relay stands."""

    title = "Robbie-MP's bridge"
    how = "the same publisher; the bridge over DDS, the core, and a module, run by `robbie run`"

    def commands(self, name: str, work: Work, work_file: Path) -> list[list[str]]:
        """Return the robot's command line, and the publisher's."""
        (_, publisher) = super().commands(name, work, work_file)
        profiles = work.folder / "profiles"
        profiles.mkdir()
        (profiles / "bench.yaml").write_text(yaml.safe_dump(profile(work, work_file)))
        start = "import sys; from robbie_mp.cli import main; sys.exit(main())"
        return [[sys.executable, "-c", start, "run", "bench", "--quiet"], publisher]


def profile(work: Work, work_file: Path) -> dict[str, object]:
    """Return the robot's profile."""
    taken = f"{'Image' if work.has_array else 'String'} bench depth={DEPTH}"
    bridge = {"middleware": "dds", "domain": domain_of(work), "accept": {topic_of(work): taken}}
    modules = {
        "subscriber": {
            "class": f"{MODULES}:RosSubscriber",
            "settings": {"work_file": str(work_file)},
            "ends_run": True,
        },
        "ros2": {"class": "robbie_mp.connect.ros2.module:Ros2Bridge", "settings": bridge},
    }
    return {"modules": modules, "black_box": False}


PEER = BridgedSubscriber()
