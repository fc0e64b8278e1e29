"""Takes the picture of RViz in docs/images: `python -m tools.ros1_picture`.

The tool starts roscore, the robot of the profile `ros1`, and RViz on a display without a screen. It sends the
robot a goal as RViz does. It needs ROS 1 with RViz, Xvfb and pillow:
apt-get install -y --no-install-recommends rviz xvfb
"""

import os
import subprocess
import sys
import tempfile
import time
from contextlib import closing
from pathlib import Path

from PIL import Image, ImageGrab

from tools.kill_campaign.robot import REPOSITORY, Robot
from tools.ros1_trial.ros import Ros

PICTURE = Path("docs/images/rviz.png")
CONFIG = "hw/robots/demo.rviz"
GOAL = "{header: {frame_id: map}, pose: {position: {x: 4.5, y: 0.3}, orientation: {w: 1.0}}}"
LOADED_S = 12.0
"""Time for which RViz runs before the robot gets its goal."""
DRIVEN_S = 0.2
COLOURS = 128


def main() -> int:
    """Take the picture."""
    with tempfile.TemporaryDirectory(prefix="robbie-rviz-") as name, closing(Ros(Path(name))) as ros:
        ros.start()
        arguments = ("ros1", "--set", f"ros1.master={ros.uri}")
        with closing(Robot(Path(name) / "run", REPOSITORY, *arguments)) as robot:
            robot.wait_until_running()
            reader, writer = os.pipe()
            screen = ["Xvfb", "-displayfd", str(writer), "-screen", "0", "1280x800x24", "-nolisten", "tcp"]
            server = subprocess.Popen(screen, pass_fds=[writer], stderr=subprocess.DEVNULL)
            display = f":{os.read(reader, 20).decode().strip()}"
            environment = {**ros.environment, "DISPLAY": display, "LIBGL_ALWAYS_SOFTWARE": "1"}
            rviz = subprocess.Popen(["rviz", "-d", CONFIG, "--fullscreen"], cwd=REPOSITORY, env=environment)
            try:
                time.sleep(LOADED_S)
                ros.rostopic("pub", "-1", "/move_base_simple/goal", "geometry_msgs/PoseStamped", GOAL)
                time.sleep(DRIVEN_S)
                taken = ImageGrab.grab(xdisplay=display)
            finally:
                for process in (rviz, server):
                    process.kill()
                    process.wait()
            robot.stop()
    taken.convert("P", palette=Image.Palette.ADAPTIVE, colors=COLOURS).save(PICTURE, optimize=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
