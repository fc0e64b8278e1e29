"""What makes a computer start a robot when it is switched on: a unit for systemd, and names for devices."""
