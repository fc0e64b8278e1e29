"""iRobot Create 2 and Roomba robots."""
