"""Robot blue sends under its own name, and as `green`, to `red`, who trusts both.

It runs outside the test's process, because Zenoh keeps threads and descriptors. It prints the names of the
robots whose packets red has got, and of those that red has seen, as JSON.
"""

import json
import socket
import sys
import time
from pathlib import Path

from robbie_mp.connect.link.header import Beat
from robbie_mp.connect.link.keys import Keys
from robbie_mp.connect.link.wire import Endpoints, InboxLimits, Wire, only_own_names

LIMIT_S = 30.0


def main(folder: Path) -> None:
    red, blue, green = (Keys(folder / name) for name in ("red", "blue", "green"))
    for keys in (red, blue, green):
        keys.make(keys.folder.name)
    for keys in (blue, green):
        red.trust(keys.own().file)
        keys.trust(red.own().file)
    with socket.create_server(("127.0.0.1", 0)) as taken:
        address = f"tls/127.0.0.1:{taken.getsockname()[1]}"
    bound = only_own_names("red", [one.robot for one in red.trusted()])

    def wire(name: str, keys: Keys, listen: list[str], **further: object) -> Wire:
        connect = [] if listen else [address]
        ways = Endpoints(
            listen=listen, connect=connect, datagrams=True, further=keys.zenoh_settings() | further
        )
        return Wire(name, 1, ways, InboxLimits(1000, 1 << 20), lambda: None)

    receiver = wire("red", red, [address], **bound)
    senders = {"green": wire("green", blue, []), "blue": wire("blue", blue, [])}
    heard: list[str] = []
    end_s = time.monotonic() + LIMIT_S
    while heard.count("blue") < 20 and time.monotonic() < end_s:
        for name, sender in senders.items():
            for as_datagram in (True, False):
                sender.send("red", Beat(name, 1, 2, 3, 4, 5), b"", as_datagram=as_datagram)
        time.sleep(0.05)
        heard += [one.robot for one in receiver.received()]
    print(json.dumps([heard, list(receiver.seen())]))
    for one in (receiver, *senders.values()):
        one.close()


if __name__ == "__main__":
    main(Path(sys.argv[1]))
