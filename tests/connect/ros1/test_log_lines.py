"""What the bridge to ROS 1 itself tells: its types are those of ROS."""

from typing import Any

from rosbags.typesys import Stores, get_typestore

from robbie_mp.connect.bridge.diagnostics import DIAGNOSTICS
from robbie_mp.connect.ros1.conversion import ros1_type
from robbie_mp.connect.ros1.log_lines import LOG, ros1_log
from robbie_mp.messages import Log, Time

NOETIC = get_typestore(Stores.ROS1_NOETIC)


def test_log_lines_and_diagnostics_are_the_types_of_ros() -> None:
    for ours in (LOG, DIAGNOSTICS):
        assert ros1_type(ours).md5 == NOETIC.generate_msgdef(ours.type_name, ros_version=1)[1]


def test_line_of_the_trace_is_read_by_ros() -> None:
    line = Log(stamp=Time(sec=5, nanosec=6), level=Log.WARN, name="mapping", msg="lost", file="a.py", line=7)
    data = ros1_type(LOG).to_ros1(ros1_log(line).encode())
    read: Any = NOETIC.deserialize_ros1(data, "rosgraph_msgs/msg/Log")
    assert (read.header.stamp.sec, read.header.stamp.nanosec) == (5, 6)
    assert (read.level, read.name, read.msg, read.file, read.line) == (4, "mapping", "lost", "a.py", 7)
