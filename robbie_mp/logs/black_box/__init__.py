"""The black box: keeps the last messages of every robot, and writes them to disk when something happens."""
