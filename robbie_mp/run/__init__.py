"""Common to all processes of a run: its plan, its folder, its clock, and the commands to its supervisor."""
