"""Velocities from another system as drive commands that expire: if no more come, the robot stops."""

import math

from robbie_mp.messages import DriveCommand, Duration, Header, Time, Twist, TwistStamped


def drive_command(
    velocity: Twist | TwistStamped, stamp: Time, valid_for_s: float, waited_s: float = 0.0
) -> DriveCommand | None:
    """Return the drive command that a velocity stands for. It rests on what was known when it arrived.

    Only the velocity forward (linear x) and about the vertical (angular z) count.

    Args:
        velocity: the velocity, in the robot's frame. A `TwistStamped` is as old as its stamp says, or older;
            without a stamp, or with one in the future, it tells nothing.
        stamp: the robot's time now.
        valid_for_s: how long it is followed after it has arrived, unless a newer one comes, s.
        waited_s: how long it has waited since it arrived, or since it was sent if that is known, s.

    Returns:
        The command; None if the velocity is not finite, or its time is over.
    """
    twist = velocity
    if isinstance(velocity, TwistStamped):
        twist, sent_ns = velocity.twist, velocity.header.stamp.nanoseconds
        waited_s = max(waited_s, (stamp.nanoseconds - sent_ns) / 1e9) if sent_ns else waited_s
    assert isinstance(twist, Twist)
    left_s = valid_for_s - waited_s
    if left_s <= 0.0 or not (math.isfinite(twist.linear.x) and math.isfinite(twist.angular.z)):
        return None
    return DriveCommand(
        header=Header(stamp=stamp, frame_id="base_link"),
        linear_m_per_s=twist.linear.x,
        angular_rad_per_s=twist.angular.z,
        valid_for=Duration.from_nanoseconds(round(left_s * 1e9)),
        based_on=Time.from_nanoseconds(stamp.nanoseconds - round(waited_s * 1e9)),
    )
