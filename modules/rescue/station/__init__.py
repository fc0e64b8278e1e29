"""What the rescue robot adds to the operator's page."""
