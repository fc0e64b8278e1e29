"""How tools, which are not modules of the profile, take part in a run."""
