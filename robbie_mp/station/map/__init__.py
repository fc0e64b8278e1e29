"""What an operator sees and sets on the map and in the 3-D view: marks, goals, drawings, the trail."""
