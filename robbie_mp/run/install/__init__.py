"""Starting a robot when its computer is switched on: a unit for systemd, and names for devices."""
