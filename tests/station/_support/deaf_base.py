"""Copied into the workspace of tests: a base that misses the first requests, as one that dies does."""

from robbie_mp import Module, setting
from robbie_mp.messages import EmergencyStop


class DeafBase(Module):
    """Follows requests to stop only after it has missed some."""

    misses: int = setting(3, "requests that it does not hear")
    period_s = 0.05

    def setup(self) -> None:
        self.missed = 0
        self.engaged = False
        self.subscribe(EmergencyStop, self.on_request, topic="emergency_stop")

    def on_request(self, request: EmergencyStop) -> None:
        if self.missed < self.misses:
            self.missed += 1
        else:
            self.engaged = request.engaged

    def tick(self) -> None:
        self.publish(EmergencyStop(engaged=self.engaged), topic="emergency_stop_state")
        self.status = f"{'STOPPED' if self.engaged else 'ready'}, missed {self.missed}"
