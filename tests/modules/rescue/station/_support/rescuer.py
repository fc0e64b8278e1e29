"""Copied into the workspace of tests: a rescue robot with a victim, and a mission that can be paused."""

import numpy as np

from robbie_mp import CallRefused, Header, Module
from robbie_mp.messages import Image, Point, Pose, PoseStamped
from robbie_robots.modules.rescue.messages import (
    AnswerVictim,
    MissionResult,
    MissionStatus,
    OrderAccepted,
    OrderMission,
    VictimAnswered,
    VictimFound,
)


class Rescuer(Module):
    """Asks about a victim until it is answered; records answers and orders."""

    period_s = 0.1

    def setup(self) -> None:
        self.file = (self.output_directory / "rescue.txt").open("a")
        self.asked = True
        self.ticks_left = 20
        self.mission = MissionStatus(
            state="EXPLORE",
            text="drives about",
            orders=np.array([OrderMission.PAUSE], np.uint8),
            used_s=61.0,
            limit_s=600.0,
        )
        self.serve(AnswerVictim, self.on_answer)
        self.serve(OrderMission, self.on_order)
        self.show_state("LOOK_AROUND")
        self.status = "all is set"

    def tick(self) -> None:
        header = Header(frame_id="map")
        pixels = np.array([0, 0, 255, 255, 0, 0], np.uint8)
        self.publish(
            VictimFound(
                header=header,
                id=7,
                name="tag 7",
                pose=Pose(position=Point(x=4.0, y=4.0, z=0.5)),
                confidence=0.75,
                views=3,
                state=VictimFound.ASKED if self.asked else VictimFound.CONFIRMED,
                answer_within_s=900.0 if self.asked else 0.0,
                image=Image(height=1, width=2, encoding="bgr8", step=6, data=pixels),
            )
        )
        self.publish(PoseStamped(header=header, pose=Pose(position=Point(x=1.5, y=3.25))), topic="map_pose")
        self.publish(self.mission)
        if self.mission.state == "ABORTED":
            self.ticks_left -= 1
            if not self.ticks_left:
                self.stop()

    def on_answer(self, answer: AnswerVictim) -> VictimAnswered:
        self.asked = False
        print("answer", answer.id, answer.answer, file=self.file, flush=True)
        return VictimAnswered(state=VictimFound.CONFIRMED)

    def on_order(self, order: OrderMission) -> OrderAccepted:
        """Pause, or end the mission; refuse all other orders."""
        print("order", order.order, file=self.file, flush=True)
        if order.order == OrderMission.ABORT:
            self.mission = MissionStatus(state="ABORTED", text="stands", used_s=62.0, limit_s=600.0)
            files = ["rescue.txt", "../secret.txt"]
            result = MissionResult(
                state="ABORTED",
                files=files,
                reason="aborted",
                confirmed=1,
                used_s=62.0,
                limit_s=600.0,
                mapped_m2=12.5,
            )
            self.publish(result, latched=True)
            return OrderAccepted(state="ABORTED")
        if order.order != OrderMission.PAUSE:
            raise CallRefused(f"no {order.order} today")
        orders = np.array([OrderMission.START, OrderMission.RETURN, OrderMission.ABORT], np.uint8)
        self.mission = MissionStatus(state="PAUSE", text="stands", orders=orders, used_s=61.0, limit_s=600.0)
        return OrderAccepted(state="PAUSE")

    def teardown(self) -> None:
        self.file.close()
