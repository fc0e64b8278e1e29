"""Crashes by what messages hold, in which order they come, and by what the module has gathered of them."""

from tests.logs.strangers_kinds.kind import Kind

MESSAGE_KINDS = [
    Kind(
        "n-th message",
        "IndexError",
        """
        from parts import Number
        from robbie_mp import Module


        class Victim(Module):
            def setup(self) -> None:
                self.rows: list[str] = ["a", "b", "c", "d"]
                self.subscribe(Number, self.on_number)

            def on_number(self, number: Number) -> None:
                self.rows.pop()  # here
        """,
    ),
    Kind(
        "KeyError after a thousand messages",
        "KeyError",
        """
        from collections import OrderedDict

        from parts import Number
        from robbie_mp import Module


        class Victim(Module):
            def setup(self) -> None:
                self.cache: OrderedDict[float, str] = OrderedDict()
                self.subscribe(Number, self.on_number)

            def on_number(self, number: Number) -> None:
                self.cache[number.value] = number.word
                if len(self.cache) > 1000:
                    self.cache.popitem(last=False)
                    del self.cache[0.0]  # here
        """,
        feeder="""
        from parts import Number
        from robbie_mp import Module


        class Feeder(Module):
            period_s = 0.005

            def setup(self) -> None:
                self.count = 0

            def tick(self) -> None:
                for _ in range(10):
                    self.publish(Number(value=float(self.count)))
                    self.count += 1
        """,
    ),
    Kind(
        "float accumulation",
        "AssertionError",
        """
        from parts import Number
        from robbie_mp import Module


        class Victim(Module):
            def setup(self) -> None:
                self.sum, self.count = 0.0, 0
                self.subscribe(Number, self.on_number)

            def on_number(self, number: Number) -> None:
                self.sum += 0.1
                self.count += 1
                assert self.count % 10 or self.sum == self.count / 10, self.sum  # here
        """,
    ),
    Kind(
        "NaN",
        "ValueError",
        """
        from parts import Number
        from robbie_mp import Module


        class Victim(Module):
            def setup(self) -> None:
                self.subscribe(Number, self.on_number)

            def on_number(self, number: Number) -> None:
                self.status = f"{round(number.value)} degrees"  # here
        """,
        feeder="""
        import math

        from parts import Number
        from robbie_mp import Module


        class Feeder(Module):
            period_s = 0.01

            def setup(self) -> None:
                self.count = 0

            def tick(self) -> None:
                self.count += 1
                self.publish(Number(value=math.nan if self.count % 12 == 0 else 1.5))
        """,
    ),
    Kind(
        "order of two topics",
        "AttributeError",
        """
        from parts import Number, Other
        from robbie_mp import Module


        class Victim(Module):
            def setup(self) -> None:
                self.pose: Other | None = None
                self.subscribe(Number, self.on_number, topic="range")
                self.subscribe(Other, self.on_other, topic="pose")

            def on_other(self, pose: Other) -> None:
                self.pose = pose

            def on_number(self, number: Number) -> None:
                x = self.pose.value + number.value  # here
                self.status, self.pose = f"{x}", None
        """,
        feeder="""
        from parts import Number, Other
        from robbie_mp import Module


        class Feeder(Module):
            period_s = 0.01

            def setup(self) -> None:
                self.count = 0

            def tick(self) -> None:
                self.count += 1
                if self.count % 9 == 0:
                    self.publish(Number(value=1.0), topic="range")
                    self.publish(Other(value=1.0), topic="pose")
                else:
                    self.publish(Other(value=1.0), topic="pose")
                    self.publish(Number(value=1.0), topic="range")
        """,
    ),
    Kind(
        "latched message",
        "ZeroDivisionError",
        """
        from parts import Number, Other
        from robbie_mp import Module


        class Victim(Module):
            def setup(self) -> None:
                self.scale = 1.0
                self.subscribe(Other, self.on_scale, topic="scale")
                self.subscribe(Number, self.on_number, topic="numbers")

            def on_scale(self, scale: Other) -> None:
                self.scale = scale.value

            def on_number(self, number: Number) -> None:
                self.status = f"{number.value / self.scale}"  # here
        """,
        feeder="""
        from parts import Number, Other
        from robbie_mp import Module


        class Feeder(Module):
            period_s = 0.1

            def setup(self) -> None:
                self.publish(Other(value=0.0), topic="scale", latched=True)

            def tick(self) -> None:
                self.publish(Number(value=1.0), topic="numbers")
        """,
    ),
    Kind(
        "keep only newest",
        "RuntimeError",
        """
        import time

        from parts import Number
        from robbie_mp import MessageHandling, Module


        class Victim(Module):
            def setup(self) -> None:
                self.last = -1.0
                self.subscribe(Number, self.on_number, MessageHandling.KEEP_ONLY_NEWEST)

            def on_number(self, number: Number) -> None:
                if self.last >= 5 and number.value > self.last + 3:
                    raise RuntimeError("too much is missing")  # here
                self.last = number.value
                time.sleep(0.05)
        """,
    ),
    Kind(
        "views of 6 MB images",
        "IndexError",
        """
        import numpy as np
        from robbie_mp import Module
        from robbie_mp.messages import Image


        class Victim(Module):
            def setup(self) -> None:
                self.before: np.ndarray | None = None
                self.subscribe(Image, self.on_image)

            def on_image(self, image: Image) -> None:
                pixels = image.data.reshape(image.height, image.width, 3)
                brightest = np.argwhere(pixels[::40, ::40, 0] > 200)
                self.status = f"{brightest[0]}"  # here
        """,
        feeder="""
        from robbie_mp import Module
        from robbie_mp.messages import Image


        class Feeder(Module):
            period_s = 0.1

            def setup(self) -> None:
                self.count = 0

            def tick(self) -> None:
                self.count += 1
                size = 1920 * 1080 * 3
                with self.loan(
                    Image, header=self.header("camera"), encoding="rgb8", height=1080, width=1920,
                    step=5760, data=size,
                ) as image:
                    image.data[:] = 0 if self.count == 6 else 220
        """,
        why_not="sooner than then",  # only the last image fits into the history
    ),
    Kind(
        "two views of 6 MB images",
        "ValueError",
        """
        import numpy as np
        from robbie_mp import Module
        from robbie_mp.messages import Image


        class Victim(Module):
            def setup(self) -> None:
                self.before: np.ndarray | None = None
                self.subscribe(Image, self.on_image)

            def on_image(self, image: Image) -> None:
                pixels = image.data.reshape(image.height, image.width, 3)[::8, ::8, 0].astype(float)
                if self.before is not None:
                    moved = np.flatnonzero(pixels != self.before)
                    self.status = f"{moved.min()}"  # here
                self.before = pixels
        """,
        feeder="""
        from robbie_mp import Module
        from robbie_mp.messages import Image


        class Feeder(Module):
            period_s = 0.1

            def setup(self) -> None:
                self.count = 0

            def tick(self) -> None:
                self.count += 1
                size = 1920 * 1080 * 3
                with self.loan(
                    Image, header=self.header("camera"), encoding="rgb8", height=1080, width=1920,
                    step=5760, data=size,
                ) as image:
                    image.data[:] = min(self.count, 7)
        """,
        why_not="sooner than then",  # only the last image fits into the history
    ),
    Kind(
        "own nested message type",
        "ValueError",
        """
        from own_messages import Found
        from robbie_mp import Module


        class Victim(Module):
            def setup(self) -> None:
                self.subscribe(Found, self.on_found)

            def on_found(self, found: Found) -> None:
                nearest = min(spot.range_m for spot in found.spots)  # here
                self.status = f"{nearest} {found.points.sum()}"
        """,
        files={
            "own_messages.py": """
            from robbie_mp import DEFAULT, Array, Message, float32, float64


            class Spot(Message, name="own_msgs/msg/Spot", version=1):
                range_m: float64 = DEFAULT
                name: str = DEFAULT


            class Found(Message, name="own_msgs/msg/Found", version=1):
                spots: list[Spot] = DEFAULT
                points: Array[float32] = DEFAULT
            """
        },
        feeder="""
        import numpy as np
        from own_messages import Found, Spot
        from robbie_mp import Module


        class Feeder(Module):
            period_s = 0.01

            def setup(self) -> None:
                self.count = 0

            def tick(self) -> None:
                self.count += 1
                spots = [Spot(range_m=float(n), name=f"s{n}") for n in range(10 - self.count)]
                self.publish(Found(spots=spots, points=np.ones(self.count, np.float32)))
        """,
    ),
    Kind(
        "encoded message",
        "DecodeError",
        """
        from parts import Number
        from robbie_mp import EncodedMessage, Module


        class Victim(Module):
            def setup(self) -> None:
                self.subscribe_encoded("*", self.on_any, topic="raw")

            def on_any(self, message: EncodedMessage) -> None:
                self.status = str(Number.decode(message.data).value)  # here
        """,
        feeder="""
        from parts import Number, Other
        from robbie_mp import Module


        class Feeder(Module):
            period_s = 0.01

            def setup(self) -> None:
                self.count = 0

            def tick(self) -> None:
                self.count += 1
                message = Other(value=1.0) if self.count == 8 else Number(value=1.0, word="a")
                self.publish(message, topic="raw")
        """,
    ),
    Kind(
        "topic, and sequence of the envelope",
        "KeyError",
        """
        from parts import Number
        from robbie_mp import Module


        class Victim(Module):
            def setup(self) -> None:
                self.names = {"laser/front": "front", "laser/rear": "rear"}
                self.subscribe(Number, self.on_number)

            def on_number(self, number: Number) -> None:
                name = self.names[self.envelope.topic]  # here
                self.status = f"{name} {self.envelope.sender} {self.envelope.sequence}"
        """,
        feeder="""
        from parts import Number
        from robbie_mp import Module


        class Feeder(Module):
            period_s = 0.01

            def setup(self) -> None:
                self.count = 0

            def tick(self) -> None:
                self.count += 1
                place = "side" if self.count == 7 else "front" if self.count % 2 else "rear"
                self.publish(Number(value=1.0), topic=f"laser/{place}")
        """,
    ),
    Kind(
        "synchronizer",
        "ZeroDivisionError",
        """
        from robbie_mp import Input, Module, Synchronizer
        from robbie_mp.messages import PoseStamped, TwistStamped


        class Victim(Module):
            def setup(self) -> None:
                self.pairs = Synchronizer(
                    self, Input(PoseStamped, "point"), Input(TwistStamped, "twist"), handler=self.on_pair
                )

            def on_pair(self, point: PoseStamped, twist: TwistStamped) -> None:
                self.status = f"{point.pose.position.x / twist.twist.linear.x}"  # here
        """,
        feeder="""
        from robbie_mp import Module
        from robbie_mp.messages import Point, Pose, PoseStamped, Twist, TwistStamped, Vector3


        class Feeder(Module):
            period_s = 0.01

            def setup(self) -> None:
                self.count = 0

            def tick(self) -> None:
                self.count += 1
                header = self.header("base_link")
                self.publish(PoseStamped(header=header, pose=Pose(position=Point(x=1.0))), topic="point")
                if self.count % 3 == 0:
                    speed = float(self.count - 9)
                    twist = Twist(linear=Vector3(x=speed))
                    self.publish(TwistStamped(header=header, twist=twist), topic="twist")
        """,
    ),
    Kind(
        "scene graph",
        "TooOld",
        """
        from robbie_mp import Module
        from robbie_mp.messages import PoseStamped
        from robbie_mp.scene import SceneGraphListener


        class Victim(Module):
            def setup(self) -> None:
                self.scene = SceneGraphListener(self)
                self.subscribe(PoseStamped, self.on_point)

            def on_point(self, point: PoseStamped) -> None:
                stamp_ns = point.header.stamp.nanoseconds
                X_OB = self.scene.pose("odom", "base_link", stamp_ns)  # here
                self.status = f"{X_OB.x:.2f}"
        """,
        feeder="""
        from robbie_mp import Header, Module, Time
        from robbie_mp.messages import (
            PoseStamped, Quaternion, TFMessage, Transform, TransformStamped, Vector3,
        )


        class Feeder(Module):
            period_s = 0.02

            def setup(self) -> None:
                self.count = 0

            def tick(self) -> None:
                self.count += 1
                header = self.header("odom")
                pose = Transform(translation=Vector3(x=self.count / 10), rotation=Quaternion(w=1.0))
                moved = TransformStamped(header=header, child_frame_id="base_link", transform=pose)
                self.publish(TFMessage(transforms=[moved]), topic="tf")
                stamp = Time(sec=5) if self.count == 10 else header.stamp
                self.publish(PoseStamped(header=Header(stamp=stamp, frame_id="base_link")))
        """,
    ),
    Kind(
        "deadline of a subscription",
        "RuntimeError",
        """
        from parts import Number
        from robbie_mp import Module


        class Victim(Module):
            def setup(self) -> None:
                self.count = 0
                self.subscribe(Number, self.on_number, deadline_s=0.3, on_late=self.on_late)

            def on_number(self, number: Number) -> None:
                self.count += 1

            def on_late(self) -> None:
                raise RuntimeError(f"silence after {self.count}")  # here
        """,
        feeder="""
        from parts import Number
        from robbie_mp import Module


        class Feeder(Module):
            period_s = 0.05

            def setup(self) -> None:
                self.count = 0

            def tick(self) -> None:
                self.count += 1
                if self.count < 10:
                    self.publish(Number(value=1.0))
        """,
    ),
    Kind(
        "message of a tool",
        "KeyError",
        """
        from parts import Number
        from robbie_mp import Module


        class Victim(Module):
            def setup(self) -> None:
                self.gears = {"slow": 1, "fast": 2}
                self.subscribe(Number, self.on_number, topic="gear")

            def on_number(self, number: Number) -> None:
                self.status = f"{self.gears[number.word]}"  # here
        """,
        commands=[["pub", "gear", "{word: back}"]],
    ),
]
