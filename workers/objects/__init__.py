"""Recognition of objects that people have taught the robot."""
