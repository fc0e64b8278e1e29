"""The rescue robot's panels for the operator's page."""
