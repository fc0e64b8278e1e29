"""The household robot on the operator's page."""
