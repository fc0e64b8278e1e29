"""The link between robots: under a bad network, under kills, and with many robots."""
