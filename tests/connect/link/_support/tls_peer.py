"""A session of Zenoh over TLS, outside the test's process, because Zenoh keeps threads.

`listen PORT SETTINGS` answers what it hears, until its input ends. `ask PORT SETTINGS` prints the answer, or
"refused" if it cannot connect.
"""

import json
import sys
import threading
from typing import Any

import zenoh


def listen(session: zenoh.Session) -> None:
    def answer(sample: Any) -> None:
        session.put("test/answer", sample.payload.to_string() + ", too")

    session.declare_subscriber("test/question", answer)
    print("ready", flush=True)
    sys.stdin.read()


def ask(session: zenoh.Session) -> None:
    heard: list[str] = []
    arrived = threading.Event()

    def hear(sample: Any) -> None:
        heard.append(sample.payload.to_string())
        arrived.set()

    session.declare_subscriber("test/answer", hear)
    while not arrived.wait(0.05):
        session.put("test/question", "hello")
    print(heard[0])


def main() -> None:
    role, port, settings = sys.argv[1:]
    configuration = zenoh.Config()
    fixed = {
        "mode": '"peer"' if role == "listen" else '"client"',
        "scouting/multicast/enabled": "false",
        "listen/endpoints": "[]",
        ("listen/endpoints" if role == "listen" else "connect/endpoints"): f'["tls/127.0.0.1:{port}"]',
    }
    for key, value in (fixed | json.loads(settings)).items():
        configuration.insert_json5(key, value)
    try:
        session = zenoh.open(configuration)
    except zenoh.ZError as error:
        print("refused" if "Unable to connect" in str(error) else error)
        return
    with session:
        (listen if role == "listen" else ask)(session)


if __name__ == "__main__":
    main()
