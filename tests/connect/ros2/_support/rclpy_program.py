"""A real node of ROS 2, which runs what a test sends it: lines of JSON with a text in Python.

It runs beside ROS, not beside the robot. What the text calls `result` goes back. Argument: the domain.
"""

import json
import sys
import threading
import traceback
from collections import defaultdict
from typing import Any

import rclpy
from rclpy.executors import MultiThreadedExecutor


def main(domain: int) -> None:
    """Run texts until the input ends."""
    rclpy.init(domain_id=domain)
    node = rclpy.create_node("tester")
    executor = MultiThreadedExecutor(4)
    executor.add_node(node)
    spinning = threading.Thread(target=executor.spin, daemon=True)
    spinning.start()
    names: dict[str, Any] = {"node": node, "rclpy": rclpy, "got": defaultdict(list)}
    tell({"result": rclpy.get_rmw_implementation_identifier()})
    for line in sys.stdin:
        names["result"] = None
        try:
            exec(json.loads(line), names)
            tell({"result": names["result"]})
        except Exception:
            tell({"error": traceback.format_exc()})
    executor.shutdown(1.0)
    spinning.join()
    node.destroy_node()
    rclpy.shutdown()


def tell(answer: dict[str, Any]) -> None:
    """Write an answer."""
    print(json.dumps(answer, default=str), flush=True)


if __name__ == "__main__":
    main(int(sys.argv[1]))
