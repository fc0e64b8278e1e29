"""Copied into the workspace of tests: what the household module needs of a robot that never arrives."""

from robbie_mp import ActiveGoal, Header, Module
from robbie_mp.messages import (
    CancelNavigation,
    MapAnnotations,
    NavigateTo,
    NavigationCancelled,
    NavigationFeedback,
    NavigationResult,
    PointOfInterest,
    PoseStamped,
)
from robbie_robots.modules.manipulation.messages import HandStatus
from robbie_robots.modules.maps.planar_messages import pose_stamped

Drive = ActiveGoal[NavigateTo, NavigationFeedback, NavigationResult]


class Flat(Module):
    """Knows two places, has an arm, and drives for ever."""

    period_s = 0.1

    def setup(self) -> None:
        self.drive: Drive | None = None
        self.serve_goals(NavigateTo, self.on_drive, self.on_cancel)
        self.serve(CancelNavigation, self.on_cancel_navigation)
        places = [
            PointOfInterest(name=name, pose=self.pose(x).pose) for name, x in (("desk", 2), ("hall", 3))
        ]
        self.publish(MapAnnotations(places=places), latched=True)
        self.publish(HandStatus(state="REST"), latched=True)

    def pose(self, x_m: float) -> PoseStamped:
        stamp = self.now()
        return pose_stamped([x_m, 0.0, 0.0], Header(stamp=stamp, frame_id="map"))

    def tick(self) -> None:
        self.publish(self.pose(0.0), topic="map_pose")

    def on_drive(self, active: Drive) -> None:
        if self.drive is not None:
            self.drive.preempt("another goal")
        self.drive = active

    def on_cancel(self, active: Drive, reason: str) -> None:
        self.drive = None
        active.cancelled(reason)

    def on_cancel_navigation(self, request: CancelNavigation) -> NavigationCancelled:
        if self.drive is not None:
            self.drive.cancelled(request.reason)
        self.drive = None
        return NavigationCancelled()
