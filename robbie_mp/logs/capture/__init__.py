"""Records a run, from inside it or from outside."""
