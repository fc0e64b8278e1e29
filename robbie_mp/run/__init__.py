"""What all processes of a run agree on: its plan, its folder, its time, and how to talk to its supervisor."""
