"""Modules of a robot whose processes die, and the program of the node beside it; each keeps a journal.

A line of a journal is what was asked for, its number, and `sent`, `reply` or `error`.
"""

import time
from pathlib import Path

import numpy as np

from robbie_mp import REQUIRED, CallError, MessageHandling, Module, Reply, Request, setting
from robbie_mp.messages import Image, Point

CALL_LIMIT_S = 5.0
HEIGHT, WIDTH = 1080, 1920
NODE = """
import itertools, threading, time
from rclpy.action import ActionClient
from sensor_msgs.msg import Image
from std_srvs.srv import Trigger
from test_msgs.action import Fibonacci
class Client(ActionClient):
    _lock = threading.Lock()  # rclpy 9.1 sets it after the threads that spin have seen the client
journal, lock, is_over = open(path, "a", buffering=1), threading.Lock(), threading.Event()
def note(*words):
    with lock:
        journal.write(" ".join(map(str, words)) + "\\n")
def answer(request, response):
    response.success = True
    return response
serving = node.create_service(Trigger, "/node/ping", answer)
back = node.create_publisher(Image, "/back", 1)
def on_image(image):
    note("image", len(image.data), "reply")
    back.publish(image)
node.create_subscription(Image, "/image", on_image, 1)
ping, fibonacci = node.create_client(Trigger, "/ping"), Client(node, Fibonacci, "/fibonacci")
def ask(kind, start):
    for number in itertools.count():
        if is_over.is_set():
            return
        ended = threading.Event()
        def end(future, number=number, ended=ended):
            note(kind, number, "reply")
            ended.set()
        note(kind, number, "sent")
        give_up = start(end)
        if not ended.wait(limit_s):
            give_up()
            note(kind, number, "error")
        time.sleep(0.1)
def start_ping(end):
    future = ping.call_async(Trigger.Request())
    future.add_done_callback(end)
    return lambda: ping.remove_pending_request(future)
def start_goal(end):
    is_given_up = []
    def on_end(future):
        if not is_given_up:
            end(future)
    def on_answer(future):
        handle = future.result()
        if handle.accepted:
            handle.get_result_async().add_done_callback(on_end)
        else:
            on_end(future)
    fibonacci.send_goal_async(Fibonacci.Goal(order=4)).add_done_callback(on_answer)
    return lambda: is_given_up.append(True)
threads = [threading.Thread(target=ask, args=each) for each in (("ping", start_ping), ("goal", start_goal))]
for thread in threads:
    thread.daemon = True
    thread.start()
"""
END = "is_over.set()\nfor thread in threads:\n    thread.join()"


class Pong(Reply, name="among_deaths/srv/Ping_Response"):
    pass


class Ping(Request[Pong], name="among_deaths/srv/Ping_Request"):
    pass


class Triggered(Reply, name="std_srvs/srv/Trigger_Response"):
    success: bool
    message: str


class Trigger(Request[Triggered], name="std_srvs/srv/Trigger_Request"):
    pass


class Answerer(Module):
    """Answers nodes."""

    def setup(self) -> None:
        self.serve(Ping, lambda _: Pong())


class Caller(Module):
    """Calls the node's service all the time, whether it is there or not."""

    period_s = 0.1
    journal: Path = setting(REQUIRED, "where it writes")

    def setup(self) -> None:
        self.file = self.journal.open("a", buffering=1)
        self.number = 0

    def tick(self) -> None:
        number, self.number = self.number, self.number + 1
        self.note(number, "sent")

        def on_error(_: CallError) -> None:
            self.note(number, "error")

        self.call(Trigger(), lambda _: self.note(number, "reply"), on_error, timeout_s=CALL_LIMIT_S)

    def note(self, number: int, event: str) -> None:
        self.file.write(f"call {number} {event}\n")


class Camera(Module):
    """Publishes images of 6.2 MB, and counts those that come back."""

    period_s = 0.5

    def setup(self) -> None:
        self.subscribe(Image, self.on_image, MessageHandling.KEEP_ONLY_NEWEST, topic="back")
        self.data = np.arange(HEIGHT * WIDTH * 3, dtype=np.uint32).astype(np.uint8)
        self.came_back = self.wrong = 0

    def tick(self) -> None:
        image = Image(height=HEIGHT, width=WIDTH, step=WIDTH * 3, encoding="rgb8", data=self.data)
        self.publish(image, topic="camera")

    def on_image(self, image: Image) -> None:
        self.came_back += 1
        self.wrong += not np.array_equal(image.data, self.data)
        self.status = f"{self.came_back} {self.wrong}"


class Beat(Module):
    """Says when it is."""

    period_s = 0.02

    def tick(self) -> None:
        self.publish(Point(x=time.monotonic()), topic="beat")


class Neighbour(Module):
    """Writes how late each beat comes: the time and the latency, in s."""

    journal: Path = setting(REQUIRED, "where it writes")

    def setup(self) -> None:
        self.file = self.journal.open("a", buffering=1)
        self.subscribe(Point, self.on_beat, topic="beat")

    def on_beat(self, beat: Point) -> None:
        now_s = time.monotonic()
        self.file.write(f"{now_s} {now_s - beat.x}\n")
