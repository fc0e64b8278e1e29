"""What makes the documentation: its website, its diagrams, and the page of robots."""
