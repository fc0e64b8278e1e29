"""Tasks of the household robot."""
