"""Pioneer robots of MobileRobots, and others with the ARCOS or P2OS controller."""
