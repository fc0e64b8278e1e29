"""Messages that only the robot of the numbered signs knows."""

from typing import ClassVar

from robbie_mp import DEFAULT, Array, Header, Message, float64, int8, uint8, uint16, uint32
from robbie_mp.messages.flaws import MAX_POSITION_M, Flaw, elements_beyond, unlike_lengths


class NumberSigns(Message, name="number_msgs/msg/NumberSigns", version=1):
    """All posts on the ground and what they carry, and the order on the sheet. Published at intervals."""

    UNKNOWN: ClassVar[int8] = -1  # not known yet
    OTHER: ClassVar[int8] = -2  # something else than a digit, or nothing

    header: Header = DEFAULT  # stamp: of the newest image; frame_id: map frame
    x_m: Array[float64] = DEFAULT  # of the posts
    y_m: Array[float64] = DEFAULT
    facing_rad: Array[float64] = DEFAULT  # direction in which the sign can be read; NaN: not known
    digits: Array[int8] = DEFAULT  # 0 … 9, UNKNOWN or OTHER
    likely: Array[int8] = DEFAULT  # 0 … 9: read most often, but it may not be sure; UNKNOWN: none was read
    views: Array[uint16] = DEFAULT  # number of images in which that digit was read
    searched: Array[uint16] = (
        DEFAULT  # bit k: a board that faces in the direction k · 30° would have been read
    )
    sheet: str = DEFAULT  # the digits on the sheet, in order; empty: none was read
    images: uint32 = DEFAULT  # number of images that were searched

    def flaw(self) -> Flaw | None:
        """Return whether something is not known of each post, or a place is not finite."""
        others = ("y_m", "facing_rad", "digits", "likely", "views", "searched")
        if self.sheet and not (self.sheet.isascii() and self.sheet.isdecimal()):
            return Flaw("sheet", self.sheet, "digits")
        return unlike_lengths(self, "x_m", *others) or elements_beyond(self, MAX_POSITION_M, "x_m", "y_m")


class SignsReached(Message, name="number_msgs/msg/SignsReached", version=1, latched=True):
    """The digits that the robot has reached, in order. Published when it stands in front of another one."""

    header: Header = DEFAULT
    digits: Array[uint8] = DEFAULT
