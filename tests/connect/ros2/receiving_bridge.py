"""A bridge in its own process, which tells what bytes it has published, once it has some of each topic.

Arguments: the settings as JSON, and the number of topics.
"""

import hashlib
import json
import sys
import time

from robbie_mp import ModuleHarness
from robbie_mp.connect.ros2.module import Ros2Bridge

LIMIT_S = 30.0


def main(settings: dict[str, object], topics: int) -> None:
    """Publish what comes, and print its digests by topic."""
    end_s = time.monotonic() + LIMIT_S
    with ModuleHarness(Ros2Bridge, settings) as bridge:
        found: dict[str, str] = {}
        while len(found) < topics and time.monotonic() < end_s:
            bridge.advance(0.02)
            for one in bridge.published_encoded:
                found.setdefault(one.topic, hashlib.sha256(one.data).hexdigest())
            time.sleep(0.005)  # let the middleware's threads work
    print(json.dumps(found))


if __name__ == "__main__":
    main(json.loads(sys.argv[1]), int(sys.argv[2]))
