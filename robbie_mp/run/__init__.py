"""What all processes of a run share: its plan, its folder, its clock, and the commands to its supervisor."""
