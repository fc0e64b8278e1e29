"""Modules that use hostile texts wherever a module can use a text; copied into a workspace."""

import os
import sys

from robbie_mp import CallRefused, Header, Message, Module, Reply, Request, setting
from robbie_mp.messages import PoseStamped
from robbie_mp.module import outbox, subscriptions

HOSTILE = "\x1b]0;owned\x07\x1b[2J\x9b31m\u202egnp\x08\x7f\r[bold]x\nFORGED laser RUNNING"


class Odd(Message, name="zoo_msgs/msg/Odd", version=1):
    """A type that its module gives another name."""

    text: str = ""


class Told(Reply, name="zoo_msgs/srv/Tell_Response"):
    """Its answer."""

    text: str


class Tell(Request[Told], name="zoo_msgs/srv/Tell_Request"):
    """Asks it to tell something."""

    text: str = ""


class Hostile(Module):
    """Uses the text in topics, types, messages, its status, its settings, its log, and its output."""

    period_s = 0.05
    greeting: str = setting(HOSTILE, "what it says: " + HOSTILE, changeable=True)

    def setup(self) -> None:
        """Say it where it is said once."""
        for checking in (outbox, subscriptions):  # what a module's own process checks does not bind it
            vars(checking)["check_topic"] = lambda _topic: None
        self.status = HOSTILE
        self.log.error("%s", HOSTILE)
        print(HOSTILE, flush=True)
        print(HOSTILE, file=sys.stderr, flush=True)
        os.write(1, HOSTILE.encode() + b"\xff\n")
        Odd.type_name = f"zoo_msgs/msg/{HOSTILE}"
        self.number = 0
        self.serve(Tell, self.on_tell, topic="tell")

    def on_tell(self, request: Tell) -> Told:
        """Say it in replies and refusals."""
        if request.text:
            raise CallRefused(HOSTILE)
        return Told(text=HOSTILE)

    def tick(self) -> None:
        """Say it in messages."""
        self.number += 1
        self.status = HOSTILE + str(self.number)
        self.publish(PoseStamped(header=Header(frame_id=HOSTILE)), topic=HOSTILE)
        self.publish(Odd(text=HOSTILE), topic=HOSTILE)


class Listener(Module):
    """Receives the messages."""

    def setup(self) -> None:
        """Subscribe."""
        self.subscribe(PoseStamped, self.on_pose)

    def on_pose(self, pose: PoseStamped) -> None:
        """Repeat it."""
        self.status = pose.header.frame_id


class Crasher(Module):
    """Dies with the text in its last output."""

    period_s = 0.05

    def tick(self) -> None:
        """Die."""
        raise RuntimeError(HOSTILE)
