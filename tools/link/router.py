"""A router of Zenoh, as a process: `python -m tools.link.router ADDRESS`."""

import json
import sys
import threading


def main(address: str) -> None:
    """Route until the process is killed."""
    import zenoh  # noqa: PLC0415 - an extra

    config = zenoh.Config()
    config.insert_json5("mode", '"router"')
    config.insert_json5("listen/endpoints", json.dumps([address]))
    config.insert_json5("scouting/multicast/enabled", "false")
    with zenoh.open(config):
        threading.Event().wait()


if __name__ == "__main__":
    main(sys.argv[1])
