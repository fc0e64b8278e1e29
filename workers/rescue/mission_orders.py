"""The operator's orders to a mission, and the states in which each is accepted."""

from enum import IntEnum

from robbie_robots.workers.rescue.mission_states import ENDS, MissionState


class OperatorOrder(IntEnum):
    """An order from the operator."""

    START = 0
    PAUSE = 1
    ABORT = 2
    RETURN = 3


class OperatorOrders:
    """Records whether the operator holds the mission, and refuses orders that do not fit its state.

    Args:
        starts_by_itself: False: the robot waits until the operator starts the mission.

    Attributes:
        is_held: the operator has paused the robot.
        has_begun: the mission has left its start.
        must_order: the robot goes on by itself only after an order, as after an emergency stop.
    """

    def __init__(self, starts_by_itself: bool) -> None:
        self.is_held = not starts_by_itself
        self.has_begun = False
        self.must_order = False

    @property
    def is_awaited(self) -> bool:
        """Return whether the mission waits for the operator to start it."""
        return self.is_held and not self.has_begun

    def refusal(self, order: int, state: MissionState) -> str | None:
        """Return why an order does not fit the state. None: it fits."""
        if order not in list(OperatorOrder):
            return f"there is no order {order}; orders are " + ", ".join(
                f"{known.value} ({known.name})" for known in OperatorOrder
            )
        if state in ENDS and order in (OperatorOrder.PAUSE, OperatorOrder.ABORT):
            return f"{OperatorOrder(order).name}: the mission has ended"
        may_start = self.is_held or self.must_order or state in ENDS
        refusals = {
            OperatorOrder.START: None if may_start else "the mission is under way",
            OperatorOrder.PAUSE: "the robot stands already, until START" if self.is_held else None,
            OperatorOrder.ABORT: None,
            OperatorOrder.RETURN: self._refuses_return(state),
        }
        refusal = refusals[OperatorOrder(order)]
        return None if refusal is None else f"{OperatorOrder(order).name}: {refusal}"

    def _refuses_return(self, state: MissionState) -> str | None:
        if not self.has_begun:
            return "the mission has not begun"
        return "the robot is on its way home" if state is MissionState.RETURN else None

    def fitting(self, state: MissionState) -> list[OperatorOrder]:
        """Return the orders that fit the state."""
        return [order for order in OperatorOrder if self.refusal(order, state) is None]
