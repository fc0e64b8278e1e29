"""How long a module waits for each kind of sensor before it counts as DEGRADED; see `Module.subscribe`.

Several periods of the slowest sensor of its kind: these deadlines say that a sensor is silent. What must
stop the robot has shorter ones of its own.
"""

LASER_S = 1.0
ODOMETRY_S = 1.0
CAMERA_S = 5.0
JOINTS_S = 0.5
BATTERY_S = 10.0
