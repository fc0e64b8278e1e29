"""What processes say and die with: entries of the trace, their way to the supervisor, how to read them."""
