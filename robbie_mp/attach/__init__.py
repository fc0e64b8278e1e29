"""How a tool takes part in a run that it is no module of."""
